"""Seconds by phase of a run, and the memory it took."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

log = logging.getLogger("mantle")

# Description of each phase.
DOING = {
    "mesh": "meshing",
    "assemble": "setting up the equations",
    "compile": "loading forms, or compiling them",
    "factorize": "setting up the preconditioner",
    "solve": "solving",
    "output": "computing and writing results",
    "error": "estimating errors",
    "influence": "solving coarser models with other bone",
}
# Long phases that occur once; the others are logged at the level of debugging.
ANNOUNCED = ("mesh", "assemble", "factorize", "error", "influence")


@dataclass
class Timing:
    """Wall and CPU seconds by phase; a phase inside another counts alone.

    Attributes:
        part: Description of this part of a run, or "".
        seconds: Wall time by phase [s].
        cpu: CPU time of this process by phase [s].
        about: Expected duration of a phase, or of its object, the first time [s].
    """

    part: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    cpu: dict[str, float] = field(default_factory=dict)
    about: dict[str, float] = field(default_factory=dict)
    _open: list[tuple[float, float]] = field(default_factory=list)

    @contextmanager
    def phase(self, name: str, of: str = "") -> Iterator[None]:
        """Count the time of the block for a phase, one of `DOING`, and log its beginning."""
        phase_text = f"{DOING[name]}: {of}" if of else DOING[name]
        expected_seconds = self.about.pop(of or name, 0.0)
        if expected_seconds > 1.0:
            phase_text += f", about {expected_seconds:.0f} s"
        is_first = name not in self.seconds and name in ANNOUNCED and not self.part
        part_text = f"{self.part}: " if self.part else ""
        log.log(logging.INFO if is_first else logging.DEBUG, "     %s%s", part_text, phase_text)
        wall, cpu = time.perf_counter(), time.process_time()
        self._open.append((0.0, 0.0))
        try:
            yield
        finally:
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            inner = self._open.pop()
            self.seconds[name] = self.seconds.get(name, 0.0) + wall - inner[0]
            self.cpu[name] = self.cpu.get(name, 0.0) + cpu - inner[1]
            if self._open:
                outer = self._open[-1]
                self._open[-1] = (outer[0] + wall, outer[1] + cpu)

    def of(self, part: str) -> Timing:
        """View of the same timing that logs under the name of a part."""
        return replace(self, part=part, about={})

    def clear(self) -> None:
        """Reset all seconds."""
        self.seconds.clear()
        self.cpu.clear()


def peak_memory(of: str = "VmHWM") -> float:
    """Peak memory of this process [MB], by default the resident memory.

    From the kernel's account of this program: `getrusage` includes its parent before exec.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    return int(re.findall(rf"{of}:\s+(\d+) kB", status)[0]) * 1024 / 1e6
