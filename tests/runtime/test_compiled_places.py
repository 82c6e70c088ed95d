"""Which kernels may be taken: of the level of all cores, in folders that nobody else can write."""

import pytest

from nnpp_edge.runtime.compiled import places

V3 = "avx avx2 bmi1 bmi2 f16c fma abm movbe xsave"
V4 = f"{V3} avx512f avx512bw avx512cd avx512dq avx512vl"


@pytest.mark.parametrize(
    ("machine", "cores", "level"),
    [
        ("x86_64", [V4, V4], "x86-64-v4"),
        ("x86_64", [V4, V3], "x86-64-v3"),
        ("x86_64", [V4, V3.replace(" fma", "")], None),
        ("x86_64", [], None),
        ("aarch64", [V4], "cortex-a72"),
        ("riscv64", [V4], None),
    ],
)
def test_the_level_is_what_all_cores_have(machine, cores, level):
    text = "".join(
        f"processor\t: {at}\nflags\t\t: fpu {flags}\n\n" for at, flags in enumerate(cores)
    )
    assert places.level_of(machine, text) == level


def test_a_cache_is_taken_where_nobody_else_can_write_it(tmp_path, monkeypatch):
    base = tmp_path / "cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(base))
    ours, only_read = places.own_folders()
    assert ours.parent == base and only_read == []
    for folder in (base, ours):
        for mode in (0o770, 0o707):
            folder.chmod(mode)
            assert places.own_folders() == (None, [])
        folder.chmod(0o700)
    assert places.own_folders() == (ours, [])
