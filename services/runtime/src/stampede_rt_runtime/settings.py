"""The settings of a service: a frozen dataclass, filled from flags, the environment, a file and defaults.

For each setting the first of these sources that has a value wins.

A field `lease_ttl_nanos: int = field(default=5 * 10**9, metadata=setting(help="...", parse=parse_duration))` of the
service `supernode` can be given in three ways: as the flag `--lease-ttl 5s`, as the variable
`STAMPEDE_SUPERNODE_LEASE_TTL` or `STAMPEDE_LEASE_TTL`, and as `lease-ttl = "5s"` in a TOML file. `--config` (or
`STAMPEDE_SUPERNODE_CONFIG`, `STAMPEDE_CONFIG`) names the file. The file has the setting in the table `[supernode]`, or
at the top if all services that read the file have that setting.
"""

from __future__ import annotations

import argparse
import dataclasses
import difflib
import json
import re
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Protocol, TypeVar, get_args, get_type_hints

from stampede_rt.values.timeline import format_duration
from stampede_rt_runtime.values import format_size, parse_bool, parse_duration, parse_int, parse_size

EXIT_BAD_SETTINGS = 2
# One file serves a whole deployment. A service ignores the tables of other services, but refuses a misspelt table.
TABLES = ("frontend", "supernode", "host", "web", "dev")
SAMPLE_COLUMNS = 100
_CREDENTIALS = re.compile(r"(?<=://)[^/\s]*(?=@)|(?<=\?).*")  # the secret parts of a URL


def unusable(source: str, text: str, error: ValueError) -> SettingsError:
    """The error for a value that `source` gives. `error` says what is allowed. Hides the credentials of a URL."""
    shown = _CREDENTIALS.sub("...", text)
    return SettingsError(f"{source}: {shown!r} cannot be used; allowed: {error}")


class SettingsError(Exception):
    """A setting is unusable. The text names the setting, its source, its value, and the allowed values."""


class HelpRequested(Exception):
    """The user gave `--help` or `--sample-settings`. The text is the answer."""


class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


S = TypeVar("S", bound=_Dataclass)


def setting(
    *,
    help: str,
    parse: Callable[[str], Any] | None = None,
    metavar: str | None = None,
    choices: Sequence[str] = (),
    minimum: int | None = None,
    maximum: int | None = None,
    shared: bool = True,
    example: str = "",
) -> dict[str, Any]:
    """The metadata of a field of a settings dataclass. A field without a default is required.

    `parse` takes the text and raises ValueError with the allowed values. Without it the field's type decides among str,
    int, bool and Path. `minimum` and `maximum`, both inclusive, are checked after parsing. If not `shared`, only the
    service's own variable is read, because the common variable means something else (for example to clients).
    `example` is the value of a required setting in the sample of a settings file.
    """
    return {
        "help": help,
        "parse": parse,
        "metavar": metavar,
        "choices": tuple(choices),
        "minimum": minimum,
        "maximum": maximum,
        "shared": shared,
        "example": example,
    }


@dataclass(frozen=True, slots=True)
class _Setting:
    """One setting, with its names in the three sources."""

    field: Field[Any]
    hint: Any
    service: str

    @property
    def name(self) -> str:
        return self.field.name.removesuffix("_nanos").replace("_", "-")

    @property
    def flag(self) -> str:
        return f"--{self.name}"

    @property
    def variables(self) -> tuple[str, ...]:
        """The environment variables, in the order of precedence."""
        upper = self.name.replace("-", "_").upper()
        own = f"STAMPEDE_{self.service.replace('-', '_').upper()}_{upper}"
        return (own, f"STAMPEDE_{upper}") if self.field.metadata.get("shared", True) else (own,)

    @property
    def required(self) -> bool:
        return self.field.default is MISSING

    def takes(self, kind: type) -> bool:
        """Whether the field's type is `kind` or `kind | None`."""
        return self.hint is kind or kind in get_args(self.hint)

    def read(self, text: str, source: str) -> Any:
        """The value of `text`. Raises SettingsError."""
        try:
            value = self._parse(text)
            self._check(value)
        except ValueError as error:
            raise unusable(source, text, error) from None
        return value

    def _parse(self, text: str) -> Any:
        parse = self.field.metadata.get("parse")
        if parse is not None:
            return parse(text)
        if self.takes(bool):
            return parse_bool(text)
        if self.takes(int):
            return parse_int(text)
        return Path(text).expanduser() if self.takes(Path) else text

    def _check(self, value: Any) -> None:
        choices = self.field.metadata.get("choices") or ()
        low, high = self.field.metadata.get("minimum"), self.field.metadata.get("maximum")
        if choices and value not in choices:
            raise ValueError(", ".join(choices))
        if isinstance(value, int) and ((low is not None and value < low) or (high is not None and value > high)):
            raise ValueError(self._range(low, high))

    def _range(self, low: int | None, high: int | None) -> str:
        if high is None:
            return f"{self._shown(low)} or more"
        return f"{self._shown(high)} or less" if low is None else f"{self._shown(low)} to {self._shown(high)}"

    def _shown(self, value: Any) -> str:
        parse = self.field.metadata.get("parse")
        if isinstance(value, int) and parse in (parse_duration, parse_size):
            return format_duration(value) if parse is parse_duration else format_size(value)
        return ",".join(value) if isinstance(value, tuple) else str(value)

    def help(self) -> str:
        """The help text with the allowed values and the default, for argparse.

        A text that states the default itself, as in "a folder; default: none", stays as it is.
        """
        default, choices = self.field.default, self.field.metadata["choices"]
        allowed = f" ({', '.join(choices)})" if choices else ""
        shown = "required" if self.required else f"default: {self._shown(default)}"
        shown = "default: none" if default is None or default == () or default == "" else shown
        shown = "default: no" if default is False else "default: yes" if default is True else shown
        text = f"{self.field.metadata['help']}{allowed}"
        return (text if "; default: " in text else f"{text} [{shown}]").replace("%", "%%")

    def sample(self) -> str:
        """The setting as lines of a settings file: its help as a comment, then its default, commented out, too."""
        default = self.field.metadata["example"] if self.required else self.field.default
        if isinstance(default, bool):
            value = str(default).lower()
        elif default is None or default in ((), ""):
            value = json.dumps(self.field.metadata["metavar"] or self.name.upper())  # the form of the value
        else:
            shown = self._shown(default)
            value = shown if isinstance(default, int) and shown == str(default) else json.dumps(shown)
        lines = textwrap.wrap(self.help().replace("%%", "%"), SAMPLE_COLUMNS - 2, break_on_hyphens=False)
        mark = "" if self.required else "#"
        return "".join(f"# {line}\n" for line in lines) + f"{mark}{self.name} = {value}\n"


class _Parser(argparse.ArgumentParser):
    """Raises errors instead of printing them and exiting."""

    def error(self, message: str) -> NoReturn:
        raise SettingsError(message)


def load_settings(cls: type[S], *, service: str, argv: Sequence[str], environ: Mapping[str, str]) -> S:
    """The settings of `service`. Raises SettingsError, or HelpRequested if `argv` asks for help or a sample.

    `cls.__post_init__` checks rules about several settings. Its ValueErrors become SettingsErrors.
    """
    known = _known(cls, service)
    flags = _read_flags(cls, known, service, argv)
    file = _read_file(known, service, flags.get("config"), environ)
    values = {s.field.name: value for s in known if (value := _pick(s, flags, environ, file)) is not MISSING}
    try:
        return cls(**values)
    except ValueError as error:
        raise SettingsError(str(error)) from error


def help_of(cls: type[S], *, service: str, argv: Sequence[str]) -> str | None:
    """The text if `argv` asks for the help or a sample of these settings; otherwise None.

    It is also None for wrong flags, which the service reports, and if `argv` begins with the name of a verb. A command
    asks this before it loads its service, so that the help comes immediately.
    """
    if argv and not argv[0].startswith("-"):
        return None
    try:
        _read_flags(cls, _known(cls, service), service, argv)
    except HelpRequested as help_request:
        return str(help_request)
    except SettingsError:
        pass
    return None


def _known(cls: type[S], service: str) -> list[_Setting]:
    """The settings in the order of the help: the service's own, then the settings of all services."""
    hints = get_type_hints(cls)
    own = vars(cls).get("__annotations__", {})
    fields = sorted(dataclasses.fields(cls), key=lambda one: one.name not in own)
    return [_Setting(field, hints[field.name], service) for field in fields]


def _read_flags(cls: type, known: list[_Setting], service: str, argv: Sequence[str]) -> dict[str, str]:
    parser = _Parser(
        prog=f"stampede {service}",
        description=cls.__doc__,
        epilog=_epilog(service, known),
        add_help=False,
        allow_abbrev=False,
    )
    parser.add_argument("-h", "--help", action="store_true", help="show this text")
    parser.add_argument("--config", metavar="FILE", help="a TOML file with settings")
    parser.add_argument("--sample-settings", action="store_true", help="show a TOML file with all settings")
    for one in known:
        if one.takes(bool):
            parser.add_argument(one.flag, action=argparse.BooleanOptionalAction, help=one.help())
        else:
            parser.add_argument(one.flag, metavar=one.field.metadata["metavar"], help=one.help())
    found, unknown = parser.parse_known_args(list(argv))
    if found.help:
        raise HelpRequested(parser.format_help())
    if found.sample_settings:
        raise HelpRequested(_sample(known, service))
    if unknown:
        raise SettingsError(
            _unknown(unknown[0], [one.flag for one in known] + ["--config", "--help", "--sample-settings"], "flag")
        )
    return {key: str(value) for key, value in vars(found).items() if value is not None}


def _sample(known: list[_Setting], service: str) -> str:
    """A settings file with every setting of the service."""
    head = (
        f"# The settings of `stampede {service}`. Name this file with --config or in $STAMPEDE_CONFIG.\n"
        "# Each setting shows its default, or the form of its value if it has no default. To set it, remove the #.\n"
    )
    return "\n".join([head, f"[{service}]\n", *(one.sample() for one in known)])


def _epilog(service: str, known: list[_Setting]) -> str:
    example = known[0]
    own, shared = example.variables
    prefix = own.removesuffix(shared.removeprefix("STAMPEDE_"))
    certificates = f"Certificates come from ${prefix}TLS_... only, because $STAMPEDE_TLS_... is for clients. "
    return (
        f"A setting can also come from the environment: {example.flag} from ${own}, or from ${shared}, which all "
        f"services read. {certificates if any(one.name.startswith('tls-') for one in known) else ''}A setting can also "
        f"be in the TOML file, as {example.name} in its table [{service}] or at the top. A flag wins over the "
        "environment, and the environment over the file."
    )


def _unknown(word: str, known: list[str], what: str) -> str:
    name = word.partition("=")[0]
    if what == "flag" and not name.startswith("-"):
        return f"{name!r} is not expected here: every setting is a flag; see --help"
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
    return f"there is no {what} {name}; {hint}"


def _read_file(
    known: list[_Setting], service: str, flag: str | None, environ: Mapping[str, str]
) -> Mapping[str, tuple[str, str]]:
    """The file's settings: name -> (text, place in the file)."""
    variables = (f"STAMPEDE_{service.replace('-', '_').upper()}_CONFIG", "STAMPEDE_CONFIG")
    path = flag or next((environ[name] for name in variables if environ.get(name)), None)
    if path is None:
        return {}
    try:
        document = tomllib.loads(Path(path).expanduser().read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise SettingsError(f"the settings file {path} cannot be read: {error}") from error
    top = {key: value for key, value in document.items() if not isinstance(value, dict)}
    for name in document.keys() - top.keys() - {service, *TABLES}:
        raise SettingsError(f"{path}: {_unknown(name, [service, *TABLES], 'table')}")
    table = document.get(service, {})
    if not isinstance(table, dict):
        raise SettingsError(f"{path}: {service} must be a table, [{service}]")
    names = sorted(one.name for one in known)
    _check_keys(table, names, f"{path}: [{service}]", "")
    _check_keys(top, names, f"{path}:", f"; put the settings of another service into its table, such as [{TABLES[0]}]")
    return {key.replace("_", "-"): (_toml_text(value), f"{path}: {key}") for key, value in (top | table).items()}


def _check_keys(keys: Iterable[str], names: list[str], where: str, way_out: str) -> None:
    for key in keys:
        if key.replace("_", "-") not in names:
            raise SettingsError(f"{where} {_unknown(key, names, 'setting')}{way_out}")


def _toml_text(value: object) -> str:
    return ",".join(str(one) for one in value) if isinstance(value, list) else str(value)


def _pick(one: _Setting, flags: dict[str, str], environ: Mapping[str, str], file: Mapping[str, tuple[str, str]]) -> Any:
    """The value from the first source that has one; MISSING keeps the default."""
    key = one.name.replace("-", "_")
    if key in flags:
        return one.read(flags[key], one.flag)
    for variable in one.variables:
        if environ.get(variable):
            return one.read(environ[variable], f"${variable}")
    if one.name in file:
        return one.read(*file[one.name])
    if one.required:
        raise SettingsError(f"{one.flag} is missing; give it, or set ${one.variables[0]}")
    return MISSING
