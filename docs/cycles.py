r"""Write the table of docs/howto/loads.md that has a history beside one step without a past.

    ./mantle run configs/history.yaml -o out/history
    S='--set mesh.size="6 mm" --set output.error=false'
    ./mantle run configs/stance_cocr.yaml $S -o out/stance_once
    ./mantle run configs/stance_cocr.yaml $S --set loads.library=walking -o out/walking_once
    ./mantle run configs/stance_cocr.yaml $S --set loads.library=walking \
        --set "stages=[{name: walking, cycles: 10, valley: 0.1}]" -o out/walking_ten
    ./mantle shell -c 'python3 docs/cycles.py out'

The mesh and the order of the displacements are the same in all four.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from app.case.number_text import in_print
from app.case.quantities import TABLE, label_with_unit
from app.results import cycles

PAGE = Path(__file__).resolve().parent / "howto" / "loads.md"
HEAD = "| at the last peak |"
RUNS = {
    "stance_once": "stance, once",
    "walking_once": "walking, once",
    "walking_ten": "ten steps",
    "history": "set, cooled, ten steps",
}
KEYS = ("slip_p99", "slip_path_p99", "motion_p99", "open_fraction")


def numbers(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Rows of one run: what it is, and its value."""
    for key in ("subsidence", "retroversion"):
        yield label_with_unit(f"stem.{key}"), TABLE["stem"][key].text(summary["stem"])
    for place in ("stem_cement", "cement_bone"):
        for key in KEYS:
            text = TABLE["interfaces"][key].text(summary["interfaces"][place])
            yield label_with_unit(f"{place}.{key}"), text
    for of_stage in summary.get("cycles", {}).values():
        for name, low, more in cycles.rows_of_cycles(of_stage):
            yield f"{in_print(name)}: permanent, inducible", f"{low}, {more}"
        lost = of_stage["dissipation"]
        yield "dissipation, second and last cycle (N mm)", f"{lost[0]:.3g}, {lost[-1]:.3g}"


def main(folder: Path) -> None:
    """Replace the table in the page."""
    columns = []
    for run in RUNS:
        columns.append(dict(numbers(json.loads((folder / run / "summary.json").read_text()))))
    rows = [[name, *(c.get(name, "-") for c in columns)] for name in columns[-1]]
    table = [f"{HEAD} {' | '.join(RUNS.values())} |", "|---" * (len(RUNS) + 1) + "|"]
    table += [f"| {' | '.join(row)} |" for row in rows]
    before, _, after = PAGE.read_text(encoding="utf-8").partition(HEAD)
    after = after.partition("\n\n")[2]
    PAGE.write_text("\n".join([before + table[0], *table[1:], "", after]), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
