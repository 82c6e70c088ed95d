"""A case of the command line: files in a folder of its own, one command, and what is wrong with how that ended."""

import contextlib
import hashlib
import itertools
import json
import os
import re
import shutil
import stat
import sys
import traceback
from dataclasses import dataclass, field
from pathlib import Path

from nnpp_edge.runtime.compiled import kernel
from tests.fuzz.children import Ended, Limits, run_forked

MOST_BYTES = 1 << 30
"""Memory that a command may take for the small inputs of a case."""
SLOW_COMMANDS = ("dataset", "train", "export", "quantize", "reproduce", "profile", "evaluate")
"""They train, trace or measure: they get more time."""
RESUMED_COMMANDS = ("dataset", "train", "reproduce")
"""They leave what is complete, to go on from."""
REPLACED = ("old/", "in/trained/", "in/set32/", "in/set/samples.png")
"""Results of earlier commands, which later ones may replace."""
STREAMED = ("--log", "--record", "--view", "--metrics-file")
EXIT_CODES = {"profile": (0, 1, 2, 3)}
USUAL_CODES = (0, 1, 2)
LOGGING_COMMANDS = ("run", "simulate")
"""They log what they refuse, before they end."""
_TEMPORARY = re.compile(r"^\..*\.[0-9a-f]{6,}$")
_PROGRESS = re.compile(
    r"^([\w ]+: \d+ %, [\d.]+ min|(ready|recording|metrics|listening): .*|warning: .*|others use .*)$"
)
_CHATTER = re.compile(
    r"^(libpng|ERROR \d|Warning \d|CPLE_|TIFF|.*\[[WEF]:onnxruntime|\[ ?(WARN|ERROR)|OpenCV|corrupted|free\(\)|"
    r"malloc|double free|munmap|terminate called|Fatal Python|Exception ignored|sys:1: |JPEG|warn\(|"
    r".*\.py:\d+: \w*Warning)",
    re.MULTILINE,
)
_TRACEBACK = "Traceback (most recent call last)"


@dataclass(frozen=True)
class Command:
    """One case."""

    words: tuple[str, ...]
    """What follows `nnpp-edge`. Names that begin with ``in/`` are samples, copied there."""
    files: dict[str, bytes] = field(default_factory=dict)
    """Further or damaged files, by their place in the folder."""
    links: dict[str, str] = field(default_factory=dict)
    """Symbolic links, by their place."""
    needs: tuple[str, ...] = ()
    """Samples that no word names."""
    stdin: bytes = b""
    streams: tuple[str, str, str] = ("null", "pipe", "pipe")
    patient: bool = False
    """It may take long, or much memory: then it must end once it is interrupted."""
    file_bytes: int = 256 << 20
    """Longest file that it can write; less plays a full disk."""
    unprivileged: bool = False
    """Run as a user who may not enter every folder."""

    def __repr__(self) -> str:
        """As a shell would have it, with what is special."""
        parts = [f"nnpp-edge {' '.join(map(_quoted, self.words))}"]
        parts += [f"{name} ({len(content)} bytes, damaged or made up)" for name, content in self.files.items()]
        parts += [f"{name} -> {target}" for name, target in self.links.items()]
        if self.streams != ("null", "pipe", "pipe"):
            parts.append(f"stdin, stdout, stderr: {', '.join(self.streams)}")
        if self.stdin:
            parts.append(f"stdin {self.stdin[:200]!r}")
        if self.file_bytes < 256 << 20:
            parts.append(f"the disk is full after {self.file_bytes} bytes of a file")
        return "; ".join(parts) + ("; without a superuser's rights" if self.unprivileged else "")


@dataclass(frozen=True)
class Problem:
    """What an oracle found."""

    kind: str
    """In a few words; findings of one kind and place are counted together."""
    detail: str = ""

    @property
    def signature(self) -> str:
        """The same for findings of the same cause, as far as that can be told."""
        frames = re.findall(r'File "[^"]*?((?:nnpp_edge|tests)/[^"]+|[^"/]+)", line \d+, in (\w+)', self.detail)
        last = [
            line
            for line in self.detail.splitlines()
            if re.match(r"^[\w.]+(Error|Exception|Interrupt|Warning)\b", line)
        ]
        ours = [f"{file}:{name}" for file, name in frames if "/" in file and "fuzz" not in file]
        return " | ".join([self.kind, *ours[-1:], *(re.sub(r"\W.*", "", line) for line in last[-1:])])


Tree = dict[str, str]
"""Each file's kind and content, by its place."""


def check(command: Command, samples: Path, folder: Path, limits: Limits | None = None) -> Problem | None:
    """Run the case in `folder`, which is made for it; what is wrong, if anything."""
    prepare(command, samples, folder)
    before = snapshot(folder)
    ended = execute(command, folder, limits or limits_of(command))
    return judge(command, ended, before, snapshot(folder))


def limits_of(command: Command) -> Limits:
    """Time and memory of a case."""
    slow = next((word for word in command.words if not word.startswith("-")), "") in SLOW_COMMANDS
    if command.patient:
        return Limits(5.0 if slow else 2.5, 90, file_bytes=command.file_bytes)
    return Limits(180.0 if slow else 60.0, 90 if slow else 25, file_bytes=command.file_bytes)


def prepare(command: Command, samples: Path, folder: Path) -> None:
    """Make the case's folder: samples, its own files, old outputs, and places where nothing can be written."""
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("in", "out", "old", "odd", "home"):
        (folder / name).mkdir(parents=True)
    named = re.findall(r"in/([\w.-]+)", " ".join([*command.words, *command.files]))
    for name in sorted({name for name in (*named, *command.needs) if len(name) < 100}):
        if name.endswith(".toml") and (samples / "tiny.onnx").exists():
            shutil.copy(samples / "tiny.onnx", folder / "in" / "tiny.onnx")
        if (samples / name).is_dir():
            shutil.copytree(samples / name, folder / "in" / name, dirs_exist_ok=True)
        elif (samples / name).exists():
            shutil.copy(samples / name, folder / "in" / name)
    for name in ("old.png", "old.npz", "old.json"):
        (folder / "old" / name).write_bytes(b"what was there before")
    (folder / "odd" / "loop").symlink_to("loop")
    with contextlib.suppress(PermissionError):
        os.mknod(folder / "odd" / "null", stat.S_IFCHR | 0o666, os.makedev(1, 3))
        os.mknod(folder / "odd" / "zero", stat.S_IFCHR | 0o666, os.makedev(1, 5))
        os.mknod(folder / "odd" / "full", stat.S_IFCHR | 0o666, os.makedev(1, 7))
    (folder / "odd" / "locked").mkdir()
    (folder / "odd" / "locked" / "dem.npz").write_bytes(b"")
    (folder / "odd" / "locked").chmod(0)
    for name, content in command.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    for name, target in command.links.items():
        path = folder / name
        if not path.is_symlink() and not path.exists():
            path.symlink_to(target)


def execute(command: Command, folder: Path, limits: Limits) -> Ended:
    """Run the command in a fork of this process."""
    home = folder / "home"
    kernels = kernel.CACHE_FOLDER.parent if kernel.CACHE_FOLDER else home  # others compiled them
    env = {
        "NUMBA_CACHE_DIR": kernels,
        "HOME": home,
        "XDG_CACHE_HOME": home,
        "XDG_CONFIG_HOME": home,
        "XDG_DATA_HOME": home,
        "TMPDIR": home,
    }

    def work() -> int:
        os.chdir(folder)
        os.environ.update({name: str(value) for name, value in env.items()})
        if command.unprivileged:
            drop_rights_over_files()
        sys.argv = ["nnpp-edge", *command.words]
        from nnpp_edge.cli.main import main

        return exit_code_of(main)

    trace = folder.with_suffix(".stack")
    trace.unlink(missing_ok=True)
    return run_forked(work, limits, streams=command.streams, stdin=command.stdin, trace=trace)


def drop_rights_over_files() -> None:
    """Let the superuser meet folders that may not be entered, as anyone else would."""
    if os.geteuid() == 0:
        import ctypes

        class Header(ctypes.Structure):
            _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int))

        head, sets = Header(0x20080522, 0), (ctypes.c_uint32 * 6)()
        libc = ctypes.CDLL(None)
        libc.capget(ctypes.byref(head), sets)
        sets[0] &= ~0b110  # CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH, of the effective set
        libc.capset(ctypes.byref(head), sets)


def exit_code_of(main: object) -> int:
    """What the interpreter would make of a program that ends so: its exit code, with a traceback on stderr."""
    assert callable(main)
    code = 0
    try:
        main()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        if isinstance(ended.code, str) and sys.stderr is not None:
            print(ended.code, file=sys.stderr)
    except BaseException:
        code = 1
        if sys.stderr is not None:
            with contextlib.suppress(OSError):
                traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            code = code or 120  # as Python does
    return code


def snapshot(folder: Path) -> Tree:
    """What a folder holds."""
    found: Tree = {}
    for top, names, files in os.walk(folder):
        for name in (*names, *files):
            path = Path(top) / name
            mode = path.lstat().st_mode
            if stat.S_ISDIR(mode):
                continue
            place = path.relative_to(folder).as_posix()
            if stat.S_ISLNK(mode):
                found[place] = f"link to {path.readlink()}"
            elif stat.S_ISREG(mode):
                found[place] = hashlib.sha1(path.read_bytes()).hexdigest() + f" {path.stat().st_size}"
            else:
                found[place] = f"device {oct(stat.S_IFMT(mode))}"
    return found


def judge(command: Command, ended: Ended, before: Tree, after: Tree) -> Problem | None:
    """What is wrong with how a command ended, and with what it left."""
    out, err = ended.out.decode("utf-8", "replace"), ended.err.decode("utf-8", "replace")
    told = f"{command!r}\nexit code {ended.code} after {ended.wall_s:.1f} s\n"
    told += f"--- stdout\n{out[-1500:]}\n--- stderr\n{err[-6000:]}"
    name = next((word for word in command.words if not word.startswith("-")), "")
    asked_to_stop = ended.interrupted and command.patient
    if ended.late and not asked_to_stop and not (command.patient and "processor" in ended.late):
        what = "cannot be interrupted" if command.patient else "hangs"
        return Problem(f"{what}: {name}", f"{told}\n--- {ended.late}")
    if "processor" in ended.late:
        return None
    if ended.code < 0:
        return Problem(f"killed by signal {-ended.code}: {name}", told)
    if _TRACEBACK in err.replace("Exception ignored", "") if not asked_to_stop else _ends_in_traceback(err):
        return Problem("traceback", told)
    if not asked_to_stop and (chatter := _CHATTER.search(err)):
        return Problem(f"chatter on stderr: {chatter[0][:40]}", told)
    if ended.code not in EXIT_CODES.get(name, USUAL_CODES):
        return Problem(f"exit code {ended.code}: {name}", told)
    if ended.peak_bytes > MOST_BYTES and not command.patient:
        return Problem(f"takes {ended.peak_bytes / 1e9:.1f} GB: {name}", told)
    return (
        _problem_of_words(command, ended, name, out, err, told, asked_to_stop)
        or _problem_of_files(command, ended, name, err, before, after, told)
        or _problem_of_json(command, ended, out, told)
    )


def _ends_in_traceback(err: str) -> bool:
    """Whether a traceback is the process's end, rather than of something that was on its way out."""
    start = err.rfind(_TRACEBACK)
    return start >= 0 and "Exception ignored" not in err[max(start - 300, 0) : start]


def _problem_of_words(
    command: Command, ended: Ended, name: str, out: str, err: str, told: str, stopped: bool
) -> Problem | None:
    """A refusal is one line; nothing ends in silence."""
    if command.streams[2] != "pipe":
        return None
    lines = [line for line in err.split("\n") if line.strip()]
    if ended.code == 2 and not stopped:
        told_at = lines if name in LOGGING_COMMANDS else lines[-1:]  # a reader's thread may log after it
        if not any(line.startswith("error: ") and line.removeprefix("error: ").strip() for line in told_at):
            return Problem(f"exit code 2 without a last line 'error: …': {name}", told)
        others = [line for line in lines[:-1] if not _PROGRESS.match(line) and name not in LOGGING_COMMANDS]
        if others:
            return Problem(f"more than one line: {name}: {others[0][:30]}", told)
        if "\r" in lines[-1] or "\x1b" in lines[-1] or len(lines[-1]) > 20_000:
            return Problem(f"the error is no plain line: {name}", told)
    if ended.code == 1 and not lines and not out.strip() and command.streams[1] == "pipe" and not stopped:
        return Problem(f"exit code 1 in silence: {name}", told)
    return None


def _problem_of_files(
    command: Command, ended: Ended, name: str, err: str, before: Tree, after: Tree, told: str
) -> Problem | None:
    """Inputs stay what they are; a refusal leaves nothing; devices stay devices; nothing temporary stays."""
    could_tell = command.streams[1] == "pipe"  # else what is written is whole, and only its name could not be printed
    for place, content in before.items():
        replaced_rightly = ended.code != 2 and place.startswith(REPLACED)
        replaced_rightly |= not could_tell and place.startswith(("in/trained/", "old/"))
        if after.get(place) != content and not replaced_rightly:
            what = "device replaced" if content.startswith("device") else "input changed"
            if place.startswith("old/"):
                what = "old output changed by a command that failed"
            return Problem(f"{what}: {name}", f"{place}: {content} became {after.get(place)}\n{told}")
    added = sorted(set(after) - set(before))
    if temporary := [place for place in added if _TEMPORARY.match(Path(place).name)]:
        return Problem(f"temporary file left: {name}", f"{temporary}\n{told}")
    refused = ended.code == 2 or (ended.code == 1 and err.rstrip().rpartition("\n")[2].startswith("error: "))
    streamed = _streamed(command) if name in LOGGING_COMMANDS else []
    left = [place for place in added if not place.startswith(("home/", *streamed))]
    if refused and left and could_tell and not ended.interrupted and name not in RESUMED_COMMANDS:
        return Problem(f"partial output: {name}", f"{left}\n{told}")
    return None


def _streamed(command: Command) -> list[str]:
    """How the names of logs and recordings begin, which are kept however the loop ends."""
    pairs = [
        word.partition("=")[::2] if "=" in word else (word, after)
        for word, after in itertools.pairwise((*command.words, ""))
    ]
    return [value.rpartition(".")[0] or value for word, value in pairs if word in STREAMED and value]


def _problem_of_json(command: Command, ended: Ended, out: str, told: str) -> Problem | None:
    """What is printed for programs is JSON, without NaN."""
    flag = "--json" in command.words and command.words[0] not in ("profile", "train")
    helps = {"-h", "--help", "--version"} & set(command.words)
    if not flag or helps or command.streams[1] != "pipe" or ended.interrupted or not out.strip():
        return None
    try:
        found = json.loads(out, parse_constant=lambda word: _no_constant(word))
    except ValueError as error:
        return Problem(f"no JSON on stdout: {command.words[0]}", f"{error}\n{told}")
    if isinstance(found, dict) and found.get("forbidden"):
        return Problem(f"a path through what is forbidden: {command.words[0]}", told)
    return None


def _no_constant(word: str) -> None:
    raise ValueError(f"{word} is no JSON")


def _quoted(word: str) -> str:
    plain = ascii(word)
    return plain if len(plain) < 200 else f"{plain[:200]}…({len(word)})"
