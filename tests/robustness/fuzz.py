"""Mutated case, sweep and study files, read in this process: ``fuzz.py SEED FIRST LAST FOLDER``.

Each is a shipped file after a few mutations of its text or content, and maybe some ``--set``
options. Reading has to end in time, with success or with an `InputError` that names a place. It
must not start processes, write files or use much memory. Other outcomes are printed, a line of JSON
each, with all data to repeat them.
"""

from __future__ import annotations

import io
import itertools
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from app import extensions  # noqa: F401  (registers keys that cases have)
from app.case import fit as fit_file
from app.case import mesh_names
from app.case import study as study_file
from app.case import sweep as sweep_file
from app.case.case import dump, load_case
from app.foundation.errors import InputError
from app.schema import yaml_file
from app.schema.units import registry
from app.soundness import cost, preview

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SECONDS = 2.0
# A study or a sweep is as many cases as it has points.
SECONDS_OF_MANY = 20.0
# Folders of files of many cases.
MANY = ("experiments", "fits", "sweeps", "studies")
MEMORY = 2 << 30
RANDOM = random.Random

# ------------------------------------------------------------------------------ of the text

PIECES = (
    *"\0|\x1b[31m|\x7f|\t|\r|\u2028|\ufeff|\ud800|\U0001d7d8|²|ﬀ|\u202e".split("|"),
    *"{ } [ ] : ' \" % @ ` # , ~ null .inf -.nan 0o7 1e400 -1e-400 1_0".split(),
    *(": ", "- ", "? ", "| ", "> ", "&a ", "*a ", "&a [*a]", "<<: *a", "<<: {<<: {}}", "---\n"),
    *("...\n", "%YAML 1.1\n---\n", "! ", "!<tag:x> y", "0x" + "f" * 400, "1" * 400),
    *("!!python/object/apply:os.system ['touch PWNED']", "!!python/name:os.system", "!!binary =="),
    *("!!int ''", "!!bool maybe", "!!float .", "!!timestamp 0", "!!set {a}"),
    *("../../etc/passwd", "/dev/zero", "$(touch PWNED)", "`touch PWNED`", "; touch PWNED;"),
    *("{a: " * 60, "[" * 500, "a" * 20_000, " " * 20_000, "mm " * 2000, "1 " + "m*" * 40 + "m"),
)


def of_text(rng: RANDOM, text: str) -> bytes:
    """A text with some of its lines or characters changed."""
    lines = text.split("\n")
    for _ in range(rng.randint(1, 4)):
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        at = rng.randint(0, len(lines[i]))
        match rng.randrange(9):
            case 0 if len(lines) > 1:
                del lines[i]
            case 1:
                lines.insert(j, lines[i])
            case 2:
                lines[i], lines[j] = lines[j], lines[i]
            case 3:
                lines[i] = " " * rng.randint(0, 7) + lines[i].lstrip()
            case 4:
                lines[i] = lines[i][:at] + chr(rng.randrange(rng.choice((128, 0x11000))))
            case 5:
                lines[i] = lines[i][:at] + lines[i][at + rng.randint(1, 5) :]
            case 6:
                del lines[i + 1 :]
                lines[i] = lines[i][:at]
            case _:
                lines[i] = lines[i][:at] + rng.choice(PIECES) + lines[i][at:]
    raw = "\n".join(lines).encode("utf-8", "surrogatepass")
    if rng.random() < 0.1:
        at = rng.randint(0, len(raw))
        raw = raw[:at] + rng.randbytes(rng.randint(1, 9)) + raw[at:]
    return raw


# --------------------------------------------------------------------------- of the content

UNITS = "mm m um GPa MPa N kN degC K W/(m^2K) s hour 1/K deg % furlong mm^9 ^ °C J/(kg K)".split()
KEYS = (
    *"../../x /etc/passwd a.b a/b . .. -x 0 é grid kind rigid history __class__ * ranks".split(),
    *("", " ", "x" * 300, "a\nb", "$(touch PWNED)", "study"),
)
EXPRESSIONS = (
    *("__import__('os').system('touch PWNED')", "(lambda: 0)()", "[x for x in (1,)]"),
    *"x.__class__ 9**9**9**9**9 x/0 sqrt(-1) f'{x}' x@y 1e999 x:=1 'a'*9 abs(*x) π".split(),
    *("x if x else y", "0x1for x", "1if x", "-" * 900 + "x", "x" + "+x" * 400),
    "(" * 300 + "x" + ")" * 300,
)
NUMBERS = (0, -1, 1e-300, 1e300, -1e30, 1e-9, 3, 10**400, 1e7, float("nan"), float("inf"))


def value(rng: RANDOM) -> Any:
    """A value that hardly any key expects."""
    number = rng.choice(NUMBERS)
    match rng.randrange(9):
        case 0:
            return number
        case 1 | 2:
            return f"{number if abs(number) < 1e308 else '1e999'} {rng.choice(UNITS)}"
        case 3:
            return rng.choice(EXPRESSIONS)
        case 4:
            return rng.choice((None, True, "", [], {}, [[]], "nan", "-inf mm", "[0, 0, 1] N"))
        case 5:
            return rng.choice(KEYS)
        case 6:
            return [value(rng) for _ in range(rng.randint(1, 4))]
        case 7:
            return {rng.choice(KEYS): value(rng) for _ in range(rng.randint(1, 3))}
        case _:
            deep: Any = 1
            for _ in range(rng.choice((5, 60, 300))):
                deep = [deep] if rng.random() < 0.5 else {"a": deep}
            return deep


def places(data: Any, depth: int = 0) -> Iterator[tuple[Any, Any]]:
    """Every container of a tree, which may contain itself, with each of its keys."""
    keys = {dict: list, list: lambda x: range(len(x))}.get(type(data), lambda x: ())(data)
    for key in keys:
        yield data, key
        if depth < 12:
            yield from itertools.islice(places(data[key], depth + 1), 1000)


def of_tree(rng: RANDOM, text: str) -> bytes:
    """A file with changed values, keys or entries."""
    data = YAML(typ="safe", pure=True).load(text)
    for _ in range(rng.randint(1, 3)):
        owner, key = rng.choice(list(places(data)) or [({}, "a")])
        other, its = rng.choice(list(places(data)) or [({}, "a")])
        match rng.randrange(7):
            case 0:
                owner.pop(key, None) if isinstance(owner, dict) else owner.pop()
            case 1 if isinstance(owner, dict):
                owner[rng.choice(KEYS)] = owner.pop(key, 1)
            case 2:
                owner[key] = other.get(its) if isinstance(other, dict) else other[its]
            case 3 if isinstance(owner.get(key) if isinstance(owner, dict) else owner[key], list):
                owner[key] = owner[key] * rng.choice((0, 2, 50))
            case 4 if isinstance(owner, dict) and isinstance(owner.get(key), str):
                words = owner[key].split(" ")
                owner[key] = f"{words[0]} {rng.choice(UNITS)}" if len(words) > 1 else words[0] + "x"
            case _:
                owner[key] = value(rng)
    return written(data).encode("utf-8", "surrogatepass")


def written(data: Any) -> str:
    """A tree as YAML with aliases."""
    yaml: Any = YAML(typ="safe", pure=True)
    yaml.width = 1 << 20
    stream = io.StringIO()
    try:
        yaml.dump(data, stream)
    except (RecursionError, ValueError):  # a tree inside itself, or a number of too many digits
        return json.dumps(str(data)[:1000])
    return stream.getvalue()


def options(rng: RANDOM, text: str) -> list[str]:
    words = re.findall(r"[a-z_]{3,}", text)
    result = []
    for _ in range(rng.randint(1, 3)):
        key = ".".join(rng.choice(words) for _ in range(rng.randint(1, 3)))
        key = rng.choice(
            (key, "mesh.size", "geometry.path", "stages.0.name", "title", "variations")
        )
        key += rng.choice(
            ("", "", "", "[0]", "[²]", "[99999999999]", ".x", "." + ".".join("a" * 99), "/..")
        )
        text = rng.choice((rng.choice(PIECES), json.dumps(value(rng)), rng.choice(EXPRESSIONS)))
        result.append(rng.choice((f"{key}={text}", f"{key}={text}", key, text)))
    return result


# ------------------------------------------------------------------------------------ reading


def read(path: Path, overrides: list[str]) -> None:
    """Read a file by the functions of the commands."""
    data = yaml_file.read(path).data
    if path.parent.name == "sweeps" or "parts" in data or "grid" in data:
        sweep_file.read(path, overrides)
    elif "study" in data or path.parent.name == "studies":
        study_file.read(path, overrides)
    elif "fit" in data or path.parent.name == "fits":
        fit_file.read(path, overrides)
    else:
        loaded = load_case(path, overrides)
        case = loaded.config
        text = preview.case_in_words(case, loaded.file.data) + cost.estimated_size(case)
        text += (
            "".join(map(str, preview.input_notes(case)))
            + dump(case)
            + str(cost.estimated_seconds(case))
        )
        text.encode()


class Late(BaseException):
    """The attempt takes too long."""


def _late(*_: object) -> None:
    raise Late


def guard(allowed: Path) -> None:
    """Forbid, in this process and for good, calls that no reader of a file makes."""
    forbidden = re.compile(r"os\.(system|exec|posix_spawn|fork|remove|rename)|subprocess|socket\.")

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if forbidden.match(event) and event not in ("os.remove", "os.rename"):
            raise PermissionError(f"{event} {arguments}")
        if event == "open" and isinstance(arguments[0], str) and arguments[2] & os.O_ACCMODE:
            if not Path(arguments[0]).resolve().is_relative_to(allowed):
                raise PermissionError(f"writes {arguments[0]}")

    sys.addaudithook(hook)


def wrong(call: Callable[[], None], names: tuple[str, ...], seconds: float) -> str:
    """Fault in the outcome of a call, in words; empty without one."""
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        call()
    except InputError as error:
        for message in error.messages or [""]:
            if not message.startswith(names) or not message.isprintable() or len(message) > 20_000:
                return f"says {message[:300]!r}"
    except Late:
        return "takes too long"
    except BaseException:
        return traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return ""


def search(numbers: range, attempt: Callable[[int], dict[str, Any]]) -> None:
    """Print outcomes of attempts with some numbers, a line of JSON each.

    The last line is the number of attempts.
    """
    for i in numbers:
        failure = attempt(i)
        if failure:
            print(json.dumps({"number": i, **failure}), flush=True)
    print(json.dumps({"tried": len(numbers)}))


def main(seed: str, first: int, last: int, folder: Path) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGPROF, _late)
    shutil.copytree(CONFIGS, folder / "configs")
    cases = (p.relative_to(CONFIGS) for p in CONFIGS.rglob("*.yaml"))
    shipped = sorted(p for p in cases if p.parent.name != "library")
    registry()
    os.environ[mesh_names.ALLOWED] = "1"  # scripts are read here, never run
    for name in shipped:  # imports, and the conversions of units
        read(folder / "configs" / name, [])
    guard(folder.resolve())

    def attempt(i: int) -> dict[str, Any]:
        rng = RANDOM(f"{seed} {i}")
        name = rng.choice(shipped)
        path = folder / "configs" / name.with_stem("mutant")
        text = (CONFIGS / name).read_text(encoding="utf-8")
        raw = (of_text, of_text, of_tree, of_tree)[rng.randrange(4)](rng, text)
        path.write_bytes(raw)
        overrides = options(rng, text) if rng.random() < 0.3 else []
        many = name.parent.name in MANY or b"variations" in raw
        limit = SECONDS_OF_MANY if many else SECONDS
        # A base by its name is a shipped file.
        places = (f"{folder}", f"{CONFIGS}", "--set ")
        wrong_behaviour = wrong(lambda: read(path, overrides), places, limit)
        if not wrong_behaviour and not (folder / "PWNED").exists() and not Path("PWNED").exists():
            return {}
        shown = raw.decode("utf-8", "replace")[:100_000]
        return {"file": str(name), "overrides": overrides, "what": wrong_behaviour, "text": shown}

    search(range(first, last), attempt)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
