"""Shared parts of the schema: the base model, names, vectors, tagged choices, messages."""

from __future__ import annotations

import ast
import difflib
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import count, pairwise, takewhile
from typing import Annotated, Any, ClassVar, NoReturn, Self, TypeVar, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError, core_schema

from app.foundation.layout import alternatives
from app.schema.yaml_file import SECTION_ABOVE, Fault, Path

# Prefix of tags that pydantic puts into the path of an error for a member of a union. Such tags are
# removed before a path is shown; no key of a section begins so.
UNION_TAG = "="
T = TypeVar("T")
# Young's modulus, Coulomb's law: keeps its capital inside a sentence.
NAME_OF_PERSON = re.compile(r"[A-Z][a-z]+'s ")
VECTOR = re.compile(r"\s*\[([^\[\]]*)\](.*)", re.DOTALL)


class Section(BaseModel):
    """Base of every part of a case: immutable, no unknown keys, errors in words of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    # Fields whose values come from a file that the section names.
    from_file: ClassVar[tuple[str, ...]] = ()

    def __eq__(self, other: object) -> bool:
        """Return True for the same class with equal fields.

        Only fields are compared: cached properties may hold arrays.
        """
        if type(self) is not type(other):
            return NotImplemented
        fields = type(self).model_fields
        return all(getattr(self, key) == getattr(other, key) for key in fields)

    def __hash__(self) -> int:
        """Hash of class and fields."""
        return hash((type(self), *(getattr(self, key) for key in type(self).model_fields)))

    def added(self, name: str, kind: type[T]) -> T | None:
        """The value of a key that another package added with `add_key`; None without the key."""
        value = getattr(self, name) if name in type(self).model_fields else None
        assert value is None or isinstance(value, kind)
        return value

    @model_validator(mode="wrap")
    @classmethod
    def _in_words_of_the_file(cls, value: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(value)
        except ValidationError as error:
            defects = [_defect(f.text, f.path, f.section) for f in faults(error, cls, value)]
            raise ValidationError.from_exception_data(
                cls.__name__, [{"type": defect, "input": None} for defect in defects]
            ) from None


# Beginning of the message on an unknown key.
UNKNOWN_KEY = "unknown key; allowed: "


def faults(
    error: ValidationError, model: type[Section] = Section, mapping: object = None
) -> list[Fault]:
    """Errors of pydantic in words of the file.

    Args:
        error: The errors.
        model: Section in which they are.
        mapping: Mapping that the section was read from.
    """
    return [_in_words(entry, model, mapping) for entry in error.errors(include_url=False)]


def _in_words(entry: ErrorDetails, model: type[Section], mapping: object) -> Fault:
    section = ""
    if entry["type"] == "mantle":
        section = entry["ctx"]["section"]
    elif entry["type"] == "extra_forbidden":
        keys_beside = mapping if isinstance(mapping, Mapping) else {}
        section = _section_for_key(entry["loc"][-1], model, keys_beside)
    path, text = _path_and_text(entry, model, section)
    of_section_below = len(path) == 2 and path[0] in model.model_fields
    if of_section_below and path[1] in model.model_fields and text.startswith(UNKNOWN_KEY):
        text = f"unknown key here; it is a key of {SECTION_ABOVE}"
    return Fault(path, text, section=section)


def _path_and_text(entry: ErrorDetails, model: type[Section], section: str) -> tuple[Path, str]:
    # Pydantic marks an error in a key of a mapping by "[key]".
    path = tuple(i for i in entry["loc"] if i != "[key]" and not str(i).startswith(UNION_TAG))
    value = show(entry["input"])
    keys = tuple(model.model_fields)
    match entry["type"]:
        case "mantle":
            return (*path, *entry["ctx"]["at"]), entry["ctx"]["text"]
        case "missing":
            docstring = " ".join(docstrings(model).get(str(path[-1]), "").split())
            start = docstring[:1] if NAME_OF_PERSON.match(docstring) else docstring[:1].lower()
            expected = f": {start}{docstring[1:].rstrip('.')}" if docstring else ""
            return path[:-1], f"'{path[-1]}' is missing; expected{expected}"
        case "extra_forbidden":
            if str(entry["loc"][-1]).startswith(UNION_TAG):  # a key of the file that begins so
                path = (*path, entry["loc"][-1])
            if section:
                return path, f"unknown key here; indent it below '{section}', where it belongs"
            hint = did_you_mean(str(path[-1]), keys)
            return path, f"{UNKNOWN_KEY}{', '.join(keys)}{hint}"
        case "model_type" | "model_attributes_type":
            return path, f"{value} is not a mapping; expected keys {', '.join(keys)}"
        case "literal_error" if allowed_words := re.findall("'([^']*)'", entry["ctx"]["expected"]):
            return path, not_one_of(entry["input"], allowed_words)
        case "union_tag_invalid":
            union_value = entry["input"]
            kinds = re.findall(f"'{UNION_TAG}(\\w+)'", entry["ctx"]["expected_tags"])
            if not isinstance(union_value, dict):
                message = f"{value} is not a mapping; expected one with kind: {' | '.join(kinds)}"
                return path, message
            if not kinds:
                return path, f"{value} has no known kind; is a package missing?"
            if "kind" not in union_value:
                return (*path, "kind"), f"is missing; expected one of {', '.join(kinds)}"
            return (*path, "kind"), not_one_of(union_value["kind"], kinds)
    return path, f"{value}: {entry['msg'][0].lower()}{entry['msg'][1:]}"


def _section_for_key(key: str | int, model: type[Section], mapping: Mapping[str, object]) -> str:
    """Section to which an unknown key belongs; empty if there is none.

    An empty section directly before the key (wrong indentation), or the first one with such a key.
    """
    fields = model.model_fields
    keys_before = [name for name in takewhile(lambda name: name != key, mapping) if name in fields]
    if keys_before and mapping[keys_before[-1]] is None:
        return keys_before[-1]
    for name, field in fields.items():
        if _annotation_has_key(field.annotation, key):
            return name
    return ""


def _annotation_has_key(annotation: object, key: str | int) -> bool:
    """Return True if the sections of a type, or of any type in it, have a key."""
    if key in getattr(annotation, "model_fields", ()):
        return True
    kinds: tuple[object, ...] = ()
    if isinstance(annotation, type) and issubclass(annotation, Extensible):
        kinds = tuple(kinds_of(annotation))
    return any(_annotation_has_key(member, key) for member in (*get_args(annotation), *kinds))


def docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Docstrings of the fields of a class and of its bases.

    Pydantic's ``use_attribute_docstrings`` would read the source of every class at each start. That
    takes 0.085 s, in addition to 0.33 s for the schema.
    """
    docstring_of_key: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if base is Section or not issubclass(base, Section):
            continue
        tree = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        for field, statement in pairwise(getattr(tree, "body", ())):
            match field, statement:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(str(doc))):
                    docstring_of_key[name] = inspect.cleandoc(doc)
    added_keys = ((name, field.description) for name, field in model.model_fields.items())
    return docstring_of_key | {name: description for name, description in added_keys if description}


def _defect(text: str, at: Path, section: str = "") -> PydanticCustomError:
    return PydanticCustomError("mantle", "{text}", {"text": text, "at": at, "section": section})


def fail(text: str, at: Path = ()) -> NoReturn:
    """Report a defect of the value under validation.

    Args:
        text: The defect; what is allowed.
        at: Path of the defect below the value, if that is a mapping or a list.

    Raises:
        PydanticCustomError: Always.
    """
    raise _defect(text, at)


def text_of_defect(error: PydanticCustomError) -> str:
    """Text of a defect that `fail` reported."""
    return str((error.context or {})["text"])


@contextmanager
def defects_at(path: Path) -> Iterator[None]:
    """Place the defect of a value at its path below the value under validation.

    Raises:
        PydanticCustomError: There is a defect.
    """
    try:
        yield
    except PydanticCustomError as error:
        fail(text_of_defect(error), at=path)


def show(value: object) -> str:
    """Quote a value in a message, shortened."""
    match value:
        case bool():
            return str(value).lower()
        case dict():
            return "a mapping"
        case list() | tuple():
            return "a list"
        case None:
            return "nothing"
        case int() if value.bit_length() > 200:
            return "a huge number"
    shown_text = repr(value)
    return shown_text if len(shown_text) <= 60 else shown_text[:56] + "...'"


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """End of a message that proposes words that begin alike or are nearest; may be empty."""
    by_lowercase = {k.lower(): k for k in known}
    word = word.lower()
    with_this_start = [k for k in known if len(word) > 2 and k.lower().startswith(word)][:3]
    nearest = difflib.get_close_matches(word, by_lowercase, 1)
    suggestions = with_this_start or [by_lowercase[match] for match in nearest]
    if not suggestions:
        return ""
    return f"; did you mean {alternatives([repr(k) for k in suggestions])}?"


def _name(value: object) -> object:
    # Names become names of folders and fields.
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_-]{0,99}", value):
        expected = "expected letters, digits, _ and -, first a letter, at most 100"
        fail(f"{show(value)} is not a name; {expected}")
    return value


def _requires(kind: type | tuple[type, ...], expected: str) -> BeforeValidator:
    """Refuse everything but a type before pydantic converts it."""

    def check(value: object) -> object:
        if not isinstance(value, kind):
            fail(f"{show(value)} is not {expected}")
        return value

    return BeforeValidator(check)


Name = Annotated[str, BeforeValidator(_name)]
Text = Annotated[str, _requires(str, "text; put it in quotes")]
Truth = Annotated[bool, _requires(bool, "true or false")]
ITEMS = _requires((list, tuple), "a list")
MAPPING = _requires(dict, "a mapping of names to values")


class Scalar:
    """Base of annotations of scalar fields that convert text themselves.

    `read` and `write` replace pydantic's conversion. The method `__get_pydantic_json_schema__` of
    an annotation describes its values: to editors, and to the manual by ``x-value`` and ``x-unit``.
    """

    def read(self, value: object) -> Any:
        """Convert a value of a file to its internal form.

        Raises:
            PydanticCustomError: The value is not valid.
        """
        raise NotImplementedError

    def write(self, value: Any) -> object:
        """Convert a value to a form that `read` takes back to it."""
        return value

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Replace pydantic's schema by `read` and `write`."""
        return core_schema.no_info_plain_validator_function(
            self.read, serialization=core_schema.plain_serializer_function_ser_schema(self.write)
        )


def is_given(section: object, path: Sequence[str]) -> bool:
    """True if a key below a section is written in the case, and is neither null nor its default.

    Cases that mantle writes contain the defaults.
    """
    part: object = section
    default: object = None
    for key in path:
        if isinstance(part, BaseModel) and key in part.model_fields_set:
            default = type(part).model_fields[key].default
            part = getattr(part, key)
        elif isinstance(part, Mapping) and key in part:
            part, default = part[key], None
        else:
            return False
    return part is not None and part != default


def not_one_of(value: object, allowed: Sequence[str]) -> str:
    """Message about a value that is not among the allowed words."""
    hint = did_you_mean(value, allowed) if isinstance(value, str) else ""
    return f"{show(value)} is not one of {', '.join(allowed)}{hint}"


def distribute_unit(value: object) -> object:
    """Turn ``"[0, 0, -1800] N"`` into ``["0 N", "0 N", "-1800 N"]``.

    Any other value is returned unchanged.
    """
    match = VECTOR.fullmatch(value) if isinstance(value, str) else None
    if match:
        return [f"{entry.strip()} {match[2].strip()}".strip() for entry in _entries(match[1])]
    return value


def _entries(text: str) -> list[str]:
    """Split at commas outside parentheses."""
    entry_texts, depth = [""], 0
    for character in text:
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            entry_texts.append("")
        else:
            entry_texts[-1] += character
    return entry_texts


@dataclass(frozen=True)
class FixedList:
    """Marks a field as a list of exactly so many entries.

    Only three entries may be written as ``"[a, b, c] unit"``.

    Attributes:
        example: Value as written in a file.
        number: Number of entries.
        scalar: True if a single value stands for equal entries.
    """

    example: str
    number: int
    scalar: bool = False

    def entries(self, value: object) -> object:
        """Return the entries with their units, before each is read.

        Raises:
            PydanticCustomError: Not a list, or not of this number of entries.
        """
        number_words = {2: "two", 3: "three", 4: "four"}[self.number]
        value = distribute_unit(value) if self.number == 3 else value
        if self.scalar and value is not None and not isinstance(value, list | tuple | dict):
            return (value, value, value)
        if not isinstance(value, list | tuple):
            fail(
                f"{show(value)} is not a list of {number_words} values; expected e.g."
                f" {self.example}"
            )
        if len(value) != self.number:
            fail(f"has {len(value)} values; expected {number_words}, e.g. {self.example}")
        return value

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Distribute the unit before the entries are read."""
        return core_schema.no_info_before_validator_function(self.entries, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        """A list; three entries with units may also be one text."""
        json_schema = handler(schema)
        first_entry = json_schema.get("prefixItems", [{}])[0]
        has_units = first_entry.get("type") == "string"
        if self.number != 3 or not has_units:
            return json_schema
        return {
            "anyOf": [json_schema, {"type": "string", "examples": [self.example], "x-value": ""}]
        }


Pair = partial(FixedList, number=2)
Triple = partial(FixedList, number=3)
Four = partial(FixedList, number=4)


_DEFINITION_ORDERS = count(1)
# Functions that rebuild the schema (`case.case`) when a kind is added.
ON_NEW_KIND: list[Callable[[], object]] = []


class Extensible(Section):
    """Base of sections to which another package may add kinds.

    A subclass with a `kind` is a kind of the section; nothing has to be registered.
    """

    # Number of the class in the order of definition.
    _definition_order: ClassVar[int] = 0

    @classmethod
    def __pydantic_init_subclass__(cls, **class_options: object) -> None:
        """Number the class, and rebuild the schema with the new kind."""
        cls._definition_order = next(_DEFINITION_ORDERS)
        for rebuild in ON_NEW_KIND:
            rebuild()


E = TypeVar("E", bound=Extensible)
# Keys that packages added, by section.
_ADDED: dict[type[Section], list[str]] = {}


def added_keys(section: type[Section]) -> tuple[str, ...]:
    """Keys that packages added to a section by `add_key`."""
    return tuple(_ADDED.get(section, ()))


def add_key(to: type[Section], name: str, kind: Any, doc: str) -> None:
    """Add an optional key, None by default, to a section and to those derived from it.

    `Section.added` reads it.

    Args:
        to: The section.
        name: The key.
        kind: Type of its value: a section, or a value with its unit.
        doc: Text of the key in the manual.

    Raises:
        ValueError: The section has the key.
    """
    if name in to.model_fields:
        raise ValueError(f"{to.__name__} has a key '{name}' already")
    for section in (to, *_derived(to)):
        section.model_fields[name] = FieldInfo(
            annotation=kind | None,
            default=None,
            description=doc,
        )
        # Sections that exist already, such as defaults, have no value: the class gives None.
        setattr(section, name, None)
        if section.__pydantic_complete__:
            section.model_rebuild(force=True)
    _ADDED.setdefault(to, []).append(name)
    for rebuild in ON_NEW_KIND:
        rebuild()


def _derived(base: type[Section]) -> Iterator[type[Section]]:
    for section in base.__subclasses__():
        yield section
        yield from _derived(section)


def kinds_of(base: type[E]) -> tuple[type[E], ...]:
    """All subclasses that have a `kind` or a required key, in the order of their definition."""
    below = [c for sub in base.__subclasses__() for c in (sub, *kinds_of(sub))]
    kinds = dict.fromkeys(c for c in below if _is_kind(c))
    return tuple(sorted(kinds, key=lambda kind: kind._definition_order))


def _is_kind(model: type[BaseModel]) -> bool:
    """Return True if a section of a file can be of a class.

    Such a class has a fixed `kind` or a required key.
    """
    fields = model.model_fields
    if "kind" in fields:
        return bool(get_args(fields["kind"].annotation))
    return any(field.is_required() for field in fields.values())


@dataclass(frozen=True)
class Kinds:
    """Marks a union of models, distinguished by `kind` or by a required key that only one has.

    An `Extensible` base in place of a union stands for all its kinds.

    Attributes:
        default: Kind of a mapping that has neither `kind` nor such a key. ``.points`` stands for
            the class whose required key is ``points``, ``.`` for a class without required keys.
            Empty if a mapping must have one.
    """

    default: str = ""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """A tagged union whose tags cannot be mistaken for keys of the file."""
        classes: tuple[type[BaseModel], ...] = get_args(source) or kinds_of(source)
        tag_of_class: dict[type, str] = {}
        tag_of_key: dict[str, str] = {}
        for model in classes:
            fields = model.model_fields
            if "kind" in fields:
                tag_of_class[model] = UNION_TAG + get_args(fields["kind"].annotation)[0]
            else:
                key = next((key for key, field in fields.items() if field.is_required()), "")
                tag_of_class[model] = f"{UNION_TAG}.{key}"
                tag_of_key[key] = f"{UNION_TAG}.{key}"

        def tag_of(value: object) -> str:
            if isinstance(value, classes):
                return tag_of_class[type(value)]
            if len(classes) == 1 and tag_of_key:
                return tag_of_class[classes[0]]
            entry = value if isinstance(value, dict) else {}
            for key, tag in tag_of_key.items():
                if key in entry:
                    return tag
            return f"{UNION_TAG}{entry.get('kind', self.default)}"

        schemas = {tag_of_class[model]: handler.generate_schema(model) for model in classes}
        return core_schema.tagged_union_schema(schemas, tag_of)
