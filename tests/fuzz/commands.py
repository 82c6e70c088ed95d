"""A case of the command line: files in a folder of its own, one command, and what is wrong with how
that ended.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import stat
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from nnpp_edge.runtime.compiled import places
from tests.fuzz.cases import Place, Problem
from tests.fuzz.children import Ended, Limits, run_forked

MOST_BYTES = 1 << 30  # memory that a command may take for the small inputs of a case
SLOW_COMMANDS = ("dataset", "train", "export", "quantize", "reproduce", "profile", "evaluate")
"""They train, trace or measure: they get more time."""
RESUMED_COMMANDS = ("dataset", "train", "reproduce")  # they leave what is complete, to go on from
REPLACED = ("old/", "in/trained/")
"""Results of earlier commands, which later ones may replace."""
LOGGING_COMMANDS = (
    "run",
    "simulate",
)  # they log what they refuse, before they end, and keep logs and recordings
PLAIN = ("null", "pipe", "pipe")
_TEMPORARY = re.compile(r"^\..*\.[0-9a-f]{6,}$")
_PROGRESS = re.compile(
    r"^([\w ]+: \d+ %, [\d.]+ min|(ready|recording|metrics|listening|warning): .*|(others "
    r"use|peak memory, in) .*)$"
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
Tree = dict[str, str]  # each file's kind and content, by its place


@dataclass(frozen=True)
class Command:
    """One case: the words that follow `nnpp-edge`; names that begin with ``in/`` are samples,
    copied there.
    """

    words: tuple[str, ...]
    files: dict[str, bytes] = field(
        default_factory=dict
    )  # further or damaged files, by their place in the folder
    needs: tuple[str, ...] = ()  # samples that no word names
    link: str = "nowhere"  # where the symbolic link ``odd/link`` leads
    stdin: bytes = b""
    streams: tuple[str, str, str] = PLAIN
    patient: bool = (
        False  # it may take long, or much memory: then it must end once it is interrupted
    )
    file_bytes: int = 256 << 20  # longest file that it can write; less plays a full disk

    @property
    def name(self) -> str:
        """Of the command."""
        return next((word for word in self.words if not word.startswith("-")), "")

    def __repr__(self) -> str:
        words = [
            word if len(word) < 200 else f"{word[:200]}…({len(word)})"
            for word in map(ascii, self.words)
        ]
        parts = [
            f"nnpp-edge {' '.join(words)}",
            f"odd/link -> {self.link}",
            f"stdin {self.stdin[:200]!r}",
        ]
        parts += [
            f"{name} ({len(content)} bytes, damaged or made up)"
            for name, content in self.files.items()
        ]
        parts += [f"streams {self.streams}"] * (self.streams != PLAIN)
        parts += [f"a disk that is full after {self.file_bytes} bytes"] * (
            self.file_bytes < 256 << 20
        )
        return "; ".join(parts)


def check(command: Command, place: Place) -> Problem | None:
    """Run the case in the place's folder, which is made for it; what is wrong, if anything."""
    assert place.samples is not None and place.folder is not None
    for _ in range(2):  # the first time, other programs may have held it up
        lay_out(command, place.samples, place.folder)
        before = snapshot(place.folder)
        problem = judge(command, execute(command, place.folder), before, snapshot(place.folder))
        if problem is None or not problem.kind.startswith(("hangs", "cannot be interrupted")):
            break
    return problem


def lay_out(command: Command, samples: Path, folder: Path) -> None:
    """Make the case's folder: samples, its own files, old outputs, and places where nothing can be
    written.
    """
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("in", "out", "old", "odd", "home"):
        (folder / name).mkdir(parents=True)
    named = {
        *re.findall(r"in/([\w.-]+)", " ".join([*command.words, *command.files])),
        *command.needs,
    }
    named |= {"tiny.onnx"} if any(name.endswith(".toml") for name in named) else set()
    for name in sorted(name for name in named if len(name) < 100):
        if (samples / name).is_dir():
            shutil.copytree(samples / name, folder / "in" / name, dirs_exist_ok=True)
        elif (samples / name).exists():
            shutil.copy(samples / name, folder / "in" / name)
    for name in ("old.png", "old.npz", "old.json"):
        (folder / "old" / name).write_bytes(b"what was there before")
    (folder / "odd" / "loop").symlink_to("loop")
    (folder / "odd" / "link").symlink_to(command.link)
    for name, minor in (("null", 3), ("zero", 5), ("full", 7)):
        with contextlib.suppress(PermissionError):
            os.mknod(folder / "odd" / name, stat.S_IFCHR | 0o666, os.makedev(1, minor))
    for name, content in command.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def execute(command: Command, folder: Path) -> Ended:
    """Run the command in a fork of this process, under limits of time and memory."""
    home = folder / "home"
    names = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "TMPDIR")
    env = dict.fromkeys(names, str(home))
    env["NUMBA_CACHE_DIR"] = str(places.OWN.parent if places.OWN else home)  # others compiled them
    slow = command.name in SLOW_COMMANDS
    wall_s, cpu_s = (
        (5.0 if slow else 2.5, 90) if command.patient else (180.0, 90) if slow else (60.0, 25)
    )

    def work() -> int:
        os.chdir(folder)
        os.environ.update(env)
        sys.argv = ["nnpp-edge", *command.words]
        from nnpp_edge.cli.main import main

        return exit_code_of(main)

    limits = Limits(wall_s, cpu_s, file_bytes=command.file_bytes)
    return run_forked(work, limits, streams=command.streams, stdin=command.stdin)


def exit_code_of(main: Callable[[], object]) -> int:
    """The exit code that the interpreter would give a program that ends so, with a traceback on
    stderr.
    """
    code = 0
    try:
        main()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        if isinstance(ended.code, str) and sys.stderr is not None:
            print(ended.code, file=sys.stderr)
    except BaseException:
        code = 1
        with contextlib.suppress(OSError, AttributeError):
            traceback.print_exc()
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except (OSError, ValueError):
            code = code or 120  # as Python does
    return code


def snapshot(folder: Path) -> Tree:
    """The files that a folder holds."""
    found: Tree = {}
    for top, names, files in os.walk(folder):
        for path in (Path(top) / name for name in (*names, *files)):
            mode = path.lstat().st_mode
            place = path.relative_to(folder).as_posix()
            if stat.S_ISLNK(mode):
                found[place] = f"link to {path.readlink()}"
            elif stat.S_ISREG(mode):
                found[place] = (
                    hashlib.sha1(path.read_bytes()).hexdigest() + f" {path.stat().st_size}"
                )
            elif not stat.S_ISDIR(mode):
                found[place] = f"device {oct(stat.S_IFMT(mode))}"
    return found


def judge(command: Command, ended: Ended, before: Tree, after: Tree) -> Problem | None:
    """What is wrong with how a command ended, and with what it left."""
    out = ended.out.decode("utf-8", "replace")
    err = ended.err.decode("utf-8", "replace")
    stopped = ended.interrupted and command.patient
    name = command.name
    kind = ""
    if ended.late and not stopped and not (command.patient and "processor" in ended.late):
        kind = "cannot be interrupted" if command.patient else "hangs"
    elif "processor" in ended.late:
        return None
    elif ended.code < 0:
        kind = f"killed by signal {-ended.code}"
    elif _ends_in_traceback(err) if stopped else _TRACEBACK in err.replace("Exception ignored", ""):
        kind = "traceback"
    elif not stopped and (chatter := _CHATTER.search(err)):
        kind = f"chatter on stderr: {chatter[0][:40]}"
    elif ended.code not in ((0, 1, 2, 3) if name == "profile" else (0, 1, 2)):
        kind = f"exit code {ended.code}"
    elif ended.peak_bytes > MOST_BYTES and not command.patient:
        kind = f"takes {ended.peak_bytes / 1e9:.1f} GB"
    else:
        kind = _wrong_words(command, ended, out, err, stopped) or _wrong_files(
            command, ended, err, before, after
        )
        kind = kind or _wrong_json(command, ended, out)
    told = f"{command!r}\nexit code {ended.code} after {ended.wall_s:.1f} s {ended.late}\n"
    told += f"--- stdout\n{out[-1500:]}\n--- stderr\n{err[-6000:]}"
    return Problem(f"{kind}: {name}", told) if kind else None


def _ends_in_traceback(err: str) -> bool:
    """Whether a traceback is the process's end, rather than of something that was on its
    way out.
    """
    start = err.rfind(_TRACEBACK)
    return start >= 0 and "Exception ignored" not in err[max(start - 300, 0) : start]


def _wrong_words(command: Command, ended: Ended, out: str, err: str, stopped: bool) -> str:
    """A refusal is one line; nothing ends in silence."""
    lines = [line for line in err.split("\n") if line.strip()]
    logs = command.name in LOGGING_COMMANDS
    if command.streams[2] != "pipe" or stopped:
        return ""
    if ended.code == 2:
        told_at = lines if logs else lines[-1:]  # a reader's thread may log after it
        if not any(
            line.startswith("error: ") and line.removeprefix("error: ").strip() for line in told_at
        ):
            return "exit code 2 without a last line 'error: …'"
        if others := [line for line in lines[:-1] if not (logs or _PROGRESS.match(line))]:
            return f"more than one line: {others[0][:30]}"
        if "\r" in lines[-1] or "\x1b" in lines[-1] or len(lines[-1]) > 20_000:
            return "the error is no plain line"
    silent = ended.code == 1 and not lines and not out.strip() and command.streams[1] == "pipe"
    return "exit code 1 in silence" if silent else ""


def _wrong_files(command: Command, ended: Ended, err: str, before: Tree, after: Tree) -> str:
    """Inputs stay what they are; a refusal leaves nothing; devices stay devices; nothing temporary
    stays.
    """
    could_tell = (
        command.streams[1] == "pipe"
    )  # else what is written is whole, and only its name could not be printed
    for place, content in before.items():
        replaced_rightly = place.startswith(REPLACED if ended.code != 2 else ())
        replaced_rightly |= not could_tell and place.startswith(("in/trained/", "old/"))
        if after.get(place) != content and not replaced_rightly:
            what = "device replaced" if content.startswith("device") else f"input changed: {place}"
            return (
                "old output changed by a command that failed" if place.startswith("old/") else what
            )
    added = sorted(set(after) - set(before))
    if any(_TEMPORARY.match(Path(place).name) for place in added):
        return f"temporary file left: {added}"
    refused = ended.code == 2 or (
        ended.code == 1 and err.rstrip().rpartition("\n")[2].startswith("error: ")
    )
    left = [place for place in added if not place.startswith("home/")]
    resumed = ended.interrupted or command.name in (*RESUMED_COMMANDS, *LOGGING_COMMANDS)
    return f"partial output: {left}" if refused and left and could_tell and not resumed else ""


def _wrong_json(command: Command, ended: Ended, out: str) -> str:
    """Whatever is printed for programs is JSON, without NaN."""
    words = {*command.words}
    if (
        "--json" not in words
        or words & {"-h", "--help", "--version"}
        or command.name in ("profile", "train")
    ):
        return ""
    if command.streams[1] != "pipe" or ended.interrupted or not out.strip():
        return ""
    try:
        found = json.loads(out, parse_constant=lambda word: int(f"{word} is no JSON"))
    except ValueError:
        return "no JSON on stdout"
    return (
        "a path through what is forbidden"
        if isinstance(found, dict) and found.get("forbidden")
        else ""
    )
