"""The command blocks of a page, run as printed and in their order, in a folder where `./covey` is the launcher.

Comments of the page, unseen by its readers, say what a test does otherwise; they stand directly before the block:

    <!-- not run: REASON -->                                    the block needs what a test has not
    <!-- not run "./covey test": REASON -->                     lines that begin like this
    <!-- in the test, "./covey demo" with "--seconds 20" -->    lines that begin like this get these options: a shorter run
    <!-- in the test, Ctrl-C after 5 s ends "./covey watch" -->
    <!-- in the test, PORT is that of "./covey ps" -->          PORT stands for what the command names after tcp/127.0.0.1:

In a block, lines before `# from another terminal` run until the block ends. A block that begins with the comment `# NAME.py` or
`# NAME.toml` is written into that file, for the blocks that follow.
"""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")))
LANGUAGES = ("sh", "python", "toml")
OTHER_TERMINAL = "# from another terminal"
LONGEST = 170.0  # s for one command
MARK = re.compile(r"<!-- (not run|in the test,)(.*?) -->")


@dataclass
class Block:
    """One block of a page, with the marks that stand before it."""

    page: str
    line: int
    language: str
    text: str
    skipped: list[str] = field(default_factory=list)  # beginnings of lines that are not run; "" for the whole block
    longer: dict[str, str] = field(default_factory=dict)  # beginning of a line -> words that are added
    ended: dict[str, float] = field(default_factory=dict)  # beginning of a line -> s until Ctrl-C
    port: str = ""  # the command that names PORT

    @property
    def file(self) -> str:
        """The file that it is the text of, empty if it is none."""
        first = re.match(r"# (\w+\.(?:py|toml))(\s|$)", self.text)
        return first[1] if first else ""

    def beginnings(self) -> list[str]:
        """What the marks say lines begin with."""
        return [*filter(None, self.skipped), *self.longer, *self.ended]


def blocks_of(page: str) -> list[Block]:
    """All blocks of a page in a language that is run; raises ValueError for a mark that says nothing."""
    found, marks, inside = [], [], None
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), start=1):
        if inside is not None:
            if line.startswith("```"):
                found.append(inside)
                inside = None
            else:
                inside.text += line + "\n"
        elif line.startswith("```"):
            inside, marks = _marked(Block(page, number, line.strip("` "), ""), marks), []
        elif line.startswith("<!-- ") and MARK.match(line):
            marks.append(line)
        elif line.strip() and marks:
            raise ValueError(f"{page}:{number}: a mark belongs directly before its block")
    return [block for block in found if block.language in LANGUAGES]


def _marked(block: Block, marks: list[str]) -> Block:
    for mark in marks:
        _, _, rest = mark.partition(" run" if "not run" in mark else "test, ")
        quoted = re.findall(r'"([^"]+)"', rest)
        seconds = re.search(r"Ctrl-C after (\d+) s", rest)
        if "<!-- not run" in mark and re.search(r": \w+", rest):
            block.skipped.append(quoted[0] if quoted else "")
        elif seconds and quoted:
            block.ended[quoted[0]] = float(seconds[1])
        elif " with " in rest and len(quoted) == 2:
            block.longer[quoted[0]] = quoted[1]
        elif "PORT is" in rest and len(quoted) == 1:
            block.port = quoted[0]
        else:
            raise ValueError(f"{block.page}:{block.line}: {mark} is no mark of tests/docs.py")
    return block


class Reader:
    """Somebody who types what a page says."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "covey").symlink_to(ROOT / "covey")
        (folder / ".venv").symlink_to(Path(sys.executable).parents[1])
        (folder / "docs").symlink_to(ROOT / "docs")
        (folder / "home").mkdir()
        caches = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # what is compiled there need not be compiled again
        self._environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("COVEY_")},
            "HOME": str(folder / "home"),  # a page that writes into ~ leaves nothing behind
            "XDG_CACHE_HOME": caches,
            "PATH": f"{folder}:{os.environ['PATH']}",
            "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "deploy" / "interface")]),
        }

    def read(self, block: Block) -> None:
        """Do what a block says; raises AssertionError naming page, line, command and what it said."""
        if "" in block.skipped:
            return
        if block.file:
            (self.folder / block.file).write_text(block.text)
        elif block.language == "toml":
            (self.folder / "page.toml").write_text(block.text)
            self.type(block, "./covey check page.toml")
        elif block.language == "python":
            self._run_python(block)
        else:
            self._run_shell(block)

    def type(self, block: Block, line: str) -> str:
        """Run one line; what it printed."""
        seconds = next((after for start, after in block.ended.items() if line.startswith(start)), None)
        process = self._start(line)
        try:
            printed = process.communicate(timeout=LONGEST if seconds is None else seconds)[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT if seconds is not None else signal.SIGKILL)
            printed = process.communicate(timeout=60)[0]
        self._check(block, line, process.returncode, printed, (0,) if seconds is None else (0, 130))
        return printed

    def end(self) -> None:
        """End what still runs."""
        for control in self.folder.glob("runs/*/control.json"):
            subprocess.run(
                ["./covey", "down", "--run", control.parent.name], cwd=self.folder, env=self._environment, check=False, timeout=60
            )

    def _run_shell(self, block: Block) -> None:
        here, there, elsewhere = block.text.partition(OTHER_TERMINAL)
        lines = [self.line(block, line) for line in here.splitlines()]
        behind = [(line, self._start(line)) for line in lines if line] if there else []
        try:
            if there:
                self._wait_for_a_run(block)
            for line in elsewhere.splitlines() if there else here.splitlines():
                if self.line(block, line):
                    self.type(block, self.line(block, line))
            for line, process in behind:
                self._check(block, line, process.wait(60), "", (0,))
        finally:
            for _, process in behind:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGINT)
                process.communicate(timeout=60)

    def line(self, block: Block, line: str) -> str:
        """A line as it is run; empty if it is not."""
        command = re.sub(r"\s+#.*", "", line).strip()
        if command.startswith("#") or any(command.startswith(start) for start in block.skipped):
            return ""
        for start, words in block.longer.items():
            if command.startswith(start):
                command = _with(command, words)
        return command

    def _run_python(self, block: Block) -> None:
        text = block.text
        if block.port:
            port = re.search(r"tcp/127\.0\.0\.1:(\d+)", self.type(block, block.port))
            assert port, f"{block.page}:{block.line}: {block.port} names no endpoint"
            text = text.replace("PORT", port[1])
        (self.folder / "page.py").write_text(text)
        process = self._start(f"{sys.executable} page.py", stdin=subprocess.PIPE)
        time.sleep(4.0 if "input(" in text else 0.0)
        printed = process.communicate("\n", timeout=LONGEST)[0]
        self._check(block, "python page.py", process.returncode, printed, (0,))
        assert printed.strip(), f"{block.page}:{block.line}: prints nothing"

    def _start(self, line: str, stdin: int = subprocess.DEVNULL) -> "subprocess.Popen[str]":
        """Start a line; Ctrl-C ends it even where the tests run in the background of a shell, which ignores it there."""
        return subprocess.Popen(
            ["env", "--default-signal=INT", "bash", "-c", f"exec {line}" if line.startswith(("./covey", "covey")) else line],
            cwd=self.folder,
            env=self._environment,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def _wait_for_a_run(self, block: Block) -> None:
        end = time.monotonic() + LONGEST
        while subprocess.run(["./covey", "ps"], cwd=self.folder, env=self._environment, capture_output=True, check=False).returncode:
            assert time.monotonic() < end, f"{block.page}:{block.line}: nothing is running"
            time.sleep(0.5)

    @staticmethod
    def _check(block: Block, line: str, code: int, printed: str, right: tuple[int, ...]) -> None:
        where = f"{block.page}:{block.line}: {line}"
        assert code in right and "Traceback" not in printed, f"{where}\nexit code {code}\n{printed[-3000:]}"


def _with(command: str, words: str) -> str:
    """A command with options such as `--seconds 5 --trials 1`, each in the place of the one that it has already, or at its end."""
    for option in re.findall(r"--\S+(?: [^-\s]\S*)?", words):
        name = option.split()[0]
        command, there = re.subn(rf"{name} \S+", option, command)
        command += "" if there else f" {option}"
    return command


def problems(block: Block) -> list[str]:
    """Marks of a block that no line of it begins with."""
    lines: Mapping[str, bool] = {start: any(line.startswith(start) for line in block.text.splitlines()) for start in block.beginnings()}
    return [f"{block.page}:{block.line}: no line begins with {start!r}" for start, there in lines.items() if not there]
