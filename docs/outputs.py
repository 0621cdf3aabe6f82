"""Run the README and the tutorial and write what their commands print.

    ./mantle shell -c 'python3 docs/outputs.py'           run both, and write their outputs
    ./mantle shell -c 'python3 docs/outputs.py --check'   run both, and print what differs

The commands of a page run one after another in a new folder. A block ``text`` shows what the
command before it printed, without the lines on progress. ``<!-- file: NAME -->`` before a block of
YAML writes it as a file. The table of the README is made of the frozen numbers of the stance.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from app.case.quantities import TABLE

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", ROOT / "docs" / "tutorial.md")
FROZEN = ROOT / "tests" / "reference" / "frozen.json"
BLOCK = re.compile(r"(?:<!-- file: (\S+) -->\n)?```(sh|yaml|text)\n(.*?)```\n", re.DOTALL)
# Commands of the launcher, and the README's large run, whose table the frozen numbers give.
SKIPPED = re.compile(r"\./mantle (setup|doctor|test|explain)|.*configs/stance.yaml|mpirun")
PROGRESS = re.compile(r"^( {5}\S|solver: |converged: |results in |\[\d+/\d+\]).*\n", re.MULTILINE)
TIMED = re.compile(r"\d+(\.\d+)? (s|MB|kB)\b")
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
QUANTITIES = {
    "gap (µm)": ("gap_max", "gap_p99"),
    "slip in contact (µm)": ("slip_max", "slip_p99"),
    "motion (µm)": ("motion_max", "motion_p99"),
    "pressure (MPa)": ("pressure_max", "pressure_p95"),
    "shear (MPa)": ("shear_max", "shear_p95"),
}


def written(page: Path, size: str = "") -> str:
    """A page with what its commands print; with a size, its cases have meshes of that size."""
    text = page.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as name:
        folder, printed = Path(name), ""
        (folder / "configs").symlink_to(ROOT / "configs")

        def block(match: re.Match[str]) -> str:
            nonlocal printed
            file, language, inner = match.groups()
            if file:
                case = re.sub(r"size: \d+ mm", f"size: {size}", inner) if size else inner
                (folder / file).write_text(case, encoding="utf-8")
            for line in inner.splitlines() if language == "sh" else ():
                if not SKIPPED.match(line):
                    printed = _output(line, folder)
            return f"```text\n{printed}```\n" if language == "text" else match[0]

        return BLOCK.sub(block, tabled(text))


def tabled(text: str) -> str:
    """A page with the frozen numbers in its table of the stance."""
    return re.sub(r"(\|[^|\n]*\|[^|\n]*\|)([^|\n]*)(\|[^|\n]*\|)([^|\n]*)(\|.*)", _row, text)


def _output(line: str, folder: Path) -> str:
    """Output of a command of a page, without its progress."""
    words = shlex.split(line, comments=True)
    if words[0] == "./mantle":
        words = [sys.executable, "-m", "mantle", *words[1:]]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "120", "NO_COLOR": "1"}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    return PROGRESS.sub("", done.stdout + done.stderr)


def _row(match: re.Match[str]) -> str:
    """A row of the table of the stance, with the frozen numbers; other rows stay."""
    head, _, paper, _, rest = match.groups()
    quantity, place = (cell.strip() for cell in head.strip("|").split("|"))
    if quantity not in QUANTITIES:
        return match[0]
    cells = [_cell(case, place.replace("-", "_"), quantity) for case in ("stance", "stance_cocr")]
    return f"{head} {cells[0]} {paper} {cells[1]} {rest}"


def _cell(case: str, interface: str, quantity: str) -> str:
    """Maximum, and percentile with its error, of an interface of a frozen case."""
    numbers = json.loads(FROZEN.read_text("utf-8"))[case]
    start = f".:summary.interfaces.{interface}."
    of_interface = {
        key.removeprefix(start): n for key, n in numbers.items() if key.startswith(start)
    }
    peak, percentile = (TABLE["interfaces"][key] for key in QUANTITIES[quantity])
    digits = 0 if peak.shown == "um" else 1
    return f"{peak.factor * of_interface[peak.key]:.{digits}f} / {percentile.text(of_interface)}"


def words(text: str) -> list[str]:
    """The lines of the outputs of a page, without their numbers and spaces."""
    blocks = "".join(inner for _, language, inner in BLOCK.findall(text) if language == "text")
    return [_words(line) for line in blocks.splitlines()]


def _words(line: str) -> str:
    return " ".join(NUMBER.sub(" # ", line).split())


def differences(old: str, new: str) -> Iterator[str]:
    """Lines of a page that differ by more than times, memory and rounding."""
    lines = old.splitlines(), new.splitlines()
    if len(lines[0]) != len(lines[1]):
        yield f"{len(lines[1])} lines instead of {len(lines[0])}"
    for before, now in zip(*lines, strict=False):
        a, b = (NUMBER.findall(TIMED.sub("", line)) for line in (before, now))
        if _words(before) != _words(now) or not all(map(_equal, a, b)):
            yield f"- {before}\n+ {now}"


def _equal(a: str, b: str) -> bool:
    within = 0.01 if "." in a else 0.1  # of counts, such as iterations, the machine decides
    return abs(float(a) - float(b)) <= 1e-6 + within * abs(float(a))


def main(check: bool) -> int:
    """Write the outputs, or print what differs; the exit code tells whether something does."""
    changed = []
    for page in PAGES:
        old, new = page.read_text(encoding="utf-8"), written(page)
        changed += [f"{page.name}:\n{line}" for line in differences(old, new)] if check else []
        if not check:
            page.write_text(new, encoding="utf-8")
    sys.stdout.writelines(f"{line}\n" for line in changed)
    return int(bool(changed))


if __name__ == "__main__":
    sys.exit(main("--check" in sys.argv))
