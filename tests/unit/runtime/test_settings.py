"""Settings from flags, variables, a file and defaults."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from stampede_rt_runtime.service_settings import ServiceSettings
from stampede_rt_runtime.settings import HelpRequested, SettingsError, help_of, load_settings, setting
from stampede_rt_runtime.values import parse_address_text, parse_duration, parse_list, parse_size, parse_target


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A service for tests."""

    listen: str = field(default="localhost:1", metadata=setting(help="where", parse=parse_address_text))
    lease_ttl_nanos: int = field(
        default=5 * 10**9, metadata=setting(help="how long", parse=parse_duration, minimum=10**6, maximum=10**12)
    )
    members: tuple[str, ...] = field(default=(), metadata=setting(help="who", parse=parse_list(parse_target)))
    queue_items_max: int = field(default=8, metadata=setting(help="how many", minimum=1))
    message_bytes_max: int = field(default=2**20, metadata=setting(help="how large", parse=parse_size))
    loud: bool = field(default=False, metadata=setting(help="100 % loud"))
    level: str = field(default="info", metadata=setting(help="how much", choices=("info", "debug")))
    data_dir: Path | None = field(default=None, metadata=setting(help="a folder; default: a new one"))

    def __post_init__(self) -> None:
        if self.loud and self.level == "debug":
            raise ValueError("--loud and --level debug exclude each other; leave one out")


@dataclass(frozen=True, kw_only=True)
class DemandingSettings:
    """Needs a name."""

    name: str = field(metadata=setting(help="its name", example="rig1"))


def load(*argv: str, **environ: str) -> Sample:
    return load_settings(Sample, service="sample", argv=argv, environ=environ)


def refusal(*argv: str, **environ: str) -> str:
    with pytest.raises(SettingsError) as caught:
        load(*argv, **environ)
    return str(caught.value)


def test_without_any_input_all_settings_have_their_defaults() -> None:
    assert load() == Sample()


def test_flags_are_parsed_by_the_kind_of_their_field() -> None:
    argv = "--listen [::1]:9 --lease-ttl 250ms --members a:1,b:2 --queue-items-max 3 --message-bytes-max 64KiB --loud"
    assert load(*argv.split(), "--data-dir", "/srv/x") == Sample(
        listen="[::1]:9",
        lease_ttl_nanos=250 * 10**6,
        members=("a:1", "b:2"),
        queue_items_max=3,
        message_bytes_max=65536,
        loud=True,
        data_dir=Path("/srv/x"),
    )


def test_a_flag_wins_over_the_environment_and_the_environment_over_the_file(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('listen = "file:1"\nlease-ttl = "1s"\nqueue_items_max = 7\nlevel = "debug"\n')
    got = load("--config", str(file), "--listen", "flag:1", STAMPEDE_LISTEN="env:1", STAMPEDE_LEASE_TTL="2s")
    assert (got.listen, got.lease_ttl_nanos, got.queue_items_max, got.level) == ("flag:1", 2 * 10**9, 7, "debug")


def test_the_services_own_variable_wins_over_the_shared_one() -> None:
    assert load(STAMPEDE_SAMPLE_LISTEN="own:1", STAMPEDE_LISTEN="shared:1").listen == "own:1"


def test_an_empty_variable_counts_as_absent() -> None:
    assert load(STAMPEDE_LISTEN="").listen == "localhost:1"


def test_the_services_table_wins_over_the_top_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('level = "info"\n[sample]\nlevel = "debug"\nmembers = ["a:1", "b:2"]\n[supernode]\nx = 1\n')
    got = load(STAMPEDE_CONFIG=str(file))
    assert (got.level, got.members) == ("debug", ("a:1", "b:2"))


def test_a_boolean_can_be_switched_off_again_by_flag(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("loud = true\n")
    assert load("--config", str(file)).loud
    assert not load("--config", str(file), "--no-loud").loud


def test_an_unknown_flag_is_refused_with_the_one_that_was_probably_meant() -> None:
    assert refusal("--lisen", "x:1") == "there is no flag --lisen; did you mean --listen?"


def test_flags_cannot_be_abbreviated() -> None:
    assert "there is no flag --lis" in refusal("--lis=x:1")


def test_an_unexpected_argument_is_refused() -> None:
    assert "'start' is not expected here" in refusal("start")


def test_a_flag_without_its_value_is_refused() -> None:
    assert refusal("--listen") == "argument --listen: expected one argument"


@pytest.mark.parametrize(
    ("flag", "value", "allowed"),
    [
        ("--listen", "nonsense", "HOST:PORT"),
        ("--lease-ttl", "5", 'such as "5s"'),
        ("--lease-ttl", "-5s", "expected one argument"),
        ("--lease-ttl", "1us", "1 ms to "),
        ("--members", "a:0", "port from 1 to 65535"),
        ("--queue-items-max", "0", "1 or more"),
        ("--queue-items-max", "many", "a whole number"),
        ("--message-bytes-max", "1 MB", '"64KiB"'),
        ("--level", "verbose", "info, debug"),
    ],
)
def test_a_bad_flag_is_named_with_its_value_and_the_allowed_values(flag: str, value: str, allowed: str) -> None:
    message = refusal(flag, value)
    assert flag in message
    assert allowed in message
    assert "expected" in message or repr(value) in message


def test_a_bad_variable_is_named_with_its_value_and_the_allowed_values() -> None:
    message = refusal(STAMPEDE_SAMPLE_LOUD="perhaps")
    assert message == "$STAMPEDE_SAMPLE_LOUD: 'perhaps' cannot be used; allowed: true or false"


def test_a_bad_value_in_the_file_is_named_with_the_file(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("lease-ttl = 5\n")
    assert refusal("--config", str(file)).startswith(f"{file}: lease-ttl: '5' cannot be used; allowed: a duration")


def test_an_unknown_key_in_the_services_table_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('[sample]\nlease-tll = "5s"\n')
    assert "there is no setting lease-tll; did you mean lease-ttl?" in refusal("--config", str(file))


def test_an_unknown_key_at_the_top_is_refused_with_the_table_where_it_may_belong(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('lisen = "x:1"\n')
    message = refusal("--config", str(file))
    assert message.startswith(f"{file}: there is no setting lisen; did you mean listen?")
    assert "put the settings of another service into its table" in message


def test_a_misspelt_table_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('[sampel]\nlisten = "x:1"\n')
    assert refusal("--config", str(file)) == f"{file}: there is no table sampel; did you mean sample?"


@pytest.mark.parametrize("content", [b"= 1", b"\xff\xfe", b"sample = 3"])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "settings.toml"
    file.write_bytes(content)
    assert str(file) in refusal("--config", str(file))


def test_a_missing_file_is_named() -> None:
    assert "/nowhere/settings.toml" in refusal("--config", "/nowhere/settings.toml")


def test_settings_that_exclude_each_other_are_refused_by_the_dataclass() -> None:
    assert "exclude each other" in refusal("--loud", "--level", "debug")


def test_a_setting_without_a_default_must_be_given() -> None:
    with pytest.raises(SettingsError, match=r"--name is missing; give it, or set \$STAMPEDE_DEMANDING_NAME"):
        load_settings(DemandingSettings, service="demanding", argv=(), environ={})


def test_help_lists_every_flag_with_its_text_and_default() -> None:
    with pytest.raises(HelpRequested) as caught:
        load("--help")
    text = " ".join(str(caught.value).split())
    assert "A service for tests." in text
    assert "--lease-ttl" in text
    assert "how long [default: 5 s]" in text
    assert "100 % loud [default: no]" in text
    assert "how large [default: 1 MiB]" in text
    assert "how much (info, debug) [default: info]" in text
    assert "a folder; default: a new one [" not in text, "the text states the default itself"
    assert "STAMPEDE_SAMPLE_LISTEN" in text


@pytest.mark.parametrize(("settings", "has_certificates"), [(Sample, False), (ServiceSettings, True)])
def test_help_names_the_variables_of_certificates_only_if_there_are_such_settings(
    settings: type[Sample] | type[ServiceSettings], has_certificates: bool
) -> None:
    text = " ".join((help_of(settings, service="sample", argv=["--help"]) or "").split())
    assert ("Certificates come from $STAMPEDE_SAMPLE_TLS_... only" in text) is has_certificates
    assert text.endswith("and the environment over the file.")


def test_help_wins_over_a_missing_setting() -> None:
    with pytest.raises(HelpRequested):
        load_settings(DemandingSettings, service="demanding", argv=["--help"], environ={})


def sample_of(cls: type) -> str:
    with pytest.raises(HelpRequested) as caught:
        load_settings(cls, service="sample", argv=["--sample-settings"], environ={})
    return str(caught.value)


def test_the_sample_of_a_settings_file_loads_and_equals_the_defaults(tmp_path: Path) -> None:
    (tmp_path / "sample.toml").write_text(sample_of(Sample))
    assert load("--config", str(tmp_path / "sample.toml")) == Sample()


def test_every_setting_of_the_sample_shows_its_default_in_a_form_that_loads(tmp_path: Path) -> None:
    lines = [line.removeprefix("#") for line in sample_of(Sample).splitlines() if not line.startswith("# ")]
    shown = [line for line in lines if not re.fullmatch(r'|.* = "[A-Z-]+"', line)]
    assert len(shown) == 1 + 6  # the table, and the settings with a default
    (tmp_path / "sample.toml").write_text("\n".join(shown))
    assert load("--config", str(tmp_path / "sample.toml")) == Sample()


def test_a_required_setting_of_the_sample_has_its_example(tmp_path: Path) -> None:
    (tmp_path / "sample.toml").write_text(sample_of(DemandingSettings))
    argv = ["--config", str(tmp_path / "sample.toml")]
    assert load_settings(DemandingSettings, service="sample", argv=argv, environ={}).name == "rig1"


def test_arguments_that_ask_for_help_are_distinguished_from_a_run_a_wrong_flag_and_a_verb() -> None:
    def shown_help(*words: str) -> str | None:
        return help_of(Sample, service="host", argv=words)

    assert "usage: stampede host" in (shown_help("--help") or "")
    assert "[host]" in (shown_help("--sample-settings") or "")
    assert shown_help() is shown_help("--nonsense") is shown_help("init", "--help") is None
