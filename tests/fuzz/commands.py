"""A case of the command line: files in a folder of its own, one command, and what is wrong with how
that ended.
"""

import contextlib
import json
import os
import re
import shutil
import stat
import sys
from dataclasses import dataclass, field
from pathlib import Path

from nnpp_edge.runtime.compiled import places
from tests.fuzz.cases import Finding
from tests.fuzz.children import Limits, run_forked

MOST_BYTES = 1 << 30  # memory that a command may take for the small inputs of a case
SLOW_COMMANDS = [
    "dataset",
    "train",
    "export",
    "quantize",
    "learn",
    "reproduce",
    "profile",
    "evaluate",
]
"""They train, trace or measure: they get more time."""
RESUMED_COMMANDS = ("dataset", "train", "learn", "reproduce")
"""They leave what is complete, to go on from."""
REPLACED = ("old/", "in/trained/")
"""Results of earlier commands, which later ones may replace."""
LOGGING_COMMANDS = ("run", "simulate")
"""They log what they refuse, before they end, and keep logs and recordings."""
_TEMPORARY = re.compile(r"^\..*\.[0-9a-f]{6,}$")
_PROGRESS = re.compile(
    r"^([\w ]+: \d+ %, [\d.]+ min|(ready|recording|listening|warning): .*|(others "
    r"use|peak memory, in) .*|(loading the package|reading|costs of the map|planning|comparing|"
    r"measuring|drawing and writing|searching|driving|compiling)\b.*)$"
)
_CHATTER = re.compile(
    r"^(libpng|ERROR \d|Warning \d|CPLE_|TIFF|.*\[[WEF]:onnxruntime|\[ "
    r"?(WARN|ERROR)|OpenCV|corrupted|free\(\)|"
    r"malloc|double free|munmap|terminate called|Fatal Python|Exception ignored|sys:1: "
    r"|JPEG|warn\(|"
    r".*\.py:\d+: \w*Warning)",
    re.MULTILINE,
)
_TRACEBACK = "Traceback (most recent call last)"


@dataclass(frozen=True)
class Command:
    """One case: the words that follow `nnpp-edge`; names that begin with ``in/`` are samples,
    copied there.
    """

    words: tuple[str, ...]
    files: dict[str, bytes] = field(default_factory=dict, repr=False)
    """Further or damaged files, by their place in the folder."""
    link: str = "nowhere"  # where the symbolic link ``odd/link`` leads
    stdin: bytes = b""
    patient: bool = False
    """It may take long, or much memory: then it must end once it is interrupted."""
    file_bytes: int = 256 << 20  # longest file that it can write; less plays a full disk

    @property
    def name(self):
        """Of the command."""
        return next((word for word in self.words if not word.startswith("-")), "")


def check(command, place):
    """Run the case in the place's folder, which is made for it, and raise what is wrong."""
    for _ in range(2):  # the first time, other programs may have held it up
        lay_out(command, place.samples, place.folder)
        before = snapshot(place.folder)
        ended = execute(command, place.folder)
        kind = judge(command, ended, before, snapshot(place.folder))
        if not kind.startswith(("hangs", "cannot be interrupted")):
            break
    if kind:
        told = f"{command!r}\nexit code {ended.code} after {ended.wall_s:.1f} s {ended.late}\n"
        told += f"--- stdout\n{ended.out[-1500:]}\n--- stderr\n{ended.err[-6000:]}"
        raise Finding(f"{kind}: {command.name}", told)


def lay_out(command, samples, folder):
    """Make the case's folder: samples, its own files, old outputs, and places where nothing can be
    written.
    """
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("in", "out", "old", "odd", "home"):
        (folder / name).mkdir(parents=True)
    named = re.findall(r"in/([\w.-]+)", " ".join([*command.words, *command.files]))
    for name in {*named, "dem.npz", "tiny.onnx"}:
        with contextlib.suppress(OSError):  # what is none of the samples
            copy = shutil.copytree if (samples / name).is_dir() else shutil.copy
            copy(samples / name, folder / "in" / name)
    for ending in ("png", "npz", "json"):
        (folder / f"old/old.{ending}").write_bytes(b"what was there before")
    for name, content in command.files.items():
        (folder / name).write_bytes(content)
    (folder / "odd/loop").symlink_to("loop")
    (folder / "odd/link").symlink_to(command.link)
    for name, minor in (("null", 3), ("zero", 5), ("full", 7)):
        with contextlib.suppress(PermissionError):
            os.mknod(folder / "odd" / name, stat.S_IFCHR | 0o666, os.makedev(1, minor))


def execute(command, folder):
    """Run the command in a fork of this process, under limits of time and memory."""
    home = folder / "home"
    names = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "TMPDIR")
    env = dict.fromkeys(names, str(home))
    env["NUMBA_CACHE_DIR"] = str(places.OWN.parent if places.OWN else home)  # others compiled them
    slow = command.name in SLOW_COMMANDS
    wall_s = 180.0 if slow else 60.0
    if command.patient:
        wall_s = 5.0 if slow else 2.5

    def work():
        os.chdir(folder)
        os.environ.update(env)
        sys.argv = ["nnpp-edge", *command.words]
        from nnpp_edge.cli.main import main

        main()

    cpu_s = 90 if slow or command.patient else 25
    limits = Limits(wall_s, cpu_s, file_bytes=command.file_bytes)
    return run_forked(work, limits, command.stdin)


def snapshot(folder):
    """The files that a folder holds: kind and content of each, by its place."""
    found = {}
    for path in folder.rglob("*"):
        place = path.relative_to(folder).as_posix()
        if path.is_symlink():
            found[place] = f"link to {path.readlink()}"
        elif path.is_file():
            found[place] = f"bytes {hash(path.read_bytes())}"
        elif not path.is_dir():
            found[place] = f"device {path.stat().st_rdev}"
    return found


def judge(command, ended, before, after):
    """What is wrong with how a command ended, and with what it left; empty if nothing."""
    stopped = ended.interrupted and command.patient
    codes = (0, 1, 2, 3) if command.name == "profile" else (0, 1, 2)
    if "processor" in ended.late and command.patient:
        return ""
    if ended.late and not stopped:
        return "cannot be interrupted" if command.patient else "hangs"
    if ended.code < 0:
        return f"killed by signal {-ended.code}"
    if stopped:
        wrong = "traceback" if _ends_in_traceback(ended.err) else ""
    elif _TRACEBACK in ended.err.replace("Exception ignored", ""):
        wrong = "traceback"
    elif chatter := _CHATTER.search(ended.err):
        wrong = f"chatter on stderr: {chatter[0][:40]}"
    elif ended.code not in codes:
        wrong = f"exit code {ended.code}"
    elif ended.peak_bytes > MOST_BYTES and not command.patient:
        wrong = f"takes {ended.peak_bytes / 1e9:.1f} GB"
    else:
        wrong = _wrong_words(command, ended) or _wrong_json(command, ended)
    return wrong or _wrong_files(command, ended, before, after)


def _ends_in_traceback(err):
    """Whether a traceback is the process's end, rather than of something that was on its
    way out.
    """
    start = err.rfind(_TRACEBACK)
    return start >= 0 and "Exception ignored" not in err[max(start - 300, 0) : start]


def _wrong_words(command, ended):
    """A refusal is one line; nothing ends in silence."""
    *others, last = [line for line in ended.err.split("\n") if line.strip()] or [""]
    if command.name in LOGGING_COMMANDS:  # a reader's thread may log after it
        others = [line for line in (*others, last) if line.startswith("error: ")]
        last = others.pop() if others else last
    if ended.code == 2:
        others = [line for line in others if not _PROGRESS.match(line)]
        if not re.match(r"error: .*\S", last):
            return "exit code 2 without a last line 'error: …'"
        if others and command.name not in LOGGING_COMMANDS:
            return f"more than one line: {others[0][:30]}"
        if "\r" in last or "\x1b" in last or len(last) > 20_000:
            return "the error is no plain line"
    if ended.code == 0 and last.startswith("error: ") and command.name not in LOGGING_COMMANDS:
        return "exit code 0 after an error"
    silent = ended.code == 1 and not last and not ended.out.strip()
    return "exit code 1 in silence" if silent else ""


def _wrong_files(command, ended, before, after):
    """Inputs stay what they are; a refusal leaves nothing; devices stay devices; nothing temporary
    stays.
    """
    for place, content in before.items():
        if after.get(place) != content and (ended.code == 2 or not place.startswith(REPLACED)):
            if place.startswith("old/"):
                return "old output changed by a command that failed"
            device = content.startswith("device")
            return "device replaced" if device else f"input changed: {place}"
    added = sorted(set(after) - set(before))
    if any(_TEMPORARY.match(Path(place).name) for place in added):
        return f"temporary file left: {added}"
    last = ended.err.rstrip().rpartition("\n")[2]
    refused = ended.code == 2 or (ended.code == 1 and last.startswith("error: "))
    left = [place for place in added if not place.startswith("home/")]
    resumed = ended.interrupted or command.name in (*RESUMED_COMMANDS, *LOGGING_COMMANDS)
    return f"partial output: {left}" if refused and left and not resumed else ""


def _wrong_json(command, ended):
    """Whatever is printed for programs is JSON, without NaN."""
    words = {*command.words}
    helps = words & {"-h", "--help", "--version"}
    if "--json" not in words or helps or command.name in ("profile", "train"):
        return ""
    try:
        found = json.loads(ended.out or "{}", parse_constant=lambda _: int("no JSON"))
    except ValueError:
        return "no JSON on stdout"
    walks = isinstance(found, dict) and found.get("forbidden")
    return "a path through what is forbidden" if walks else ""
