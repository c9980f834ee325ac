"""What two runs were started with, compared: every setting that differs is named, and nothing else is."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from bench.bus.codec import Codec
from bench.record.label import label_of, names_of, resim_label
from bench.record.reader import Run
from bench.record.settings import MOST_SHOWN, NOTHING_DIFFERS, Settings, compare_settings
from bench.record.writer import RunWriter
from bench.scenario import load

METADATA = {
    **{"scenario": "formation", "seed": "1", "duration_s": "10", "buses": "udp:40001", "clock": "lockstep"},
    **{"command_line": "platoon run formation", "commit": "1234", "started": "then", "host": "here"},
    **{"platform": "Linux", "python": "3.11.7", "fmu_guid": "{1}"},
    **{"ecu planner": "a:P", "ecu tracker": "a:T", "version platoon": "0.1.0", "version numpy": "2"},
}
LOSS = '{kind="frame_loss", at_s=1.0, bus="v2v", probability=0.5}'
NOISE = '{kind="sensor_noise", at_s=1.0, bus="veh1", message="VehicleMotion", signal="YawRate", sigma=0.1}'
OUTAGE = '{kind="v2v_outage", at_s=2.0, vehicle=2}'


class Logs:
    """Makes logs of runs that did nothing."""

    def __init__(self, folder: Path, codecs: Mapping[str, Codec]) -> None:
        self.folder = folder
        self.codecs = codecs
        self.made = 0

    def __call__(
        self,
        *overrides: str,
        scenario: str = "formation",
        text: bytes | None = None,
        files: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        **changes: str,
    ) -> Run:
        self.made += 1
        path = self.folder / f"{self.made}.mcap"
        toml = load(scenario, overrides).toml().encode() if text is None else text
        attachments = {"modelDescription.xml": b"<1/>", **(files or {})}
        names = {name.replace("__", " "): value for name, value in changes.items()}
        with RunWriter(
            path,
            codecs=self.codecs,
            truth_names=("X",),
            vehicles=2,
            metadata={**(METADATA if metadata is None else metadata), **names},
            attachments={**attachments, **({"scenario.toml": toml} if toml else {})},
        ) as writer:
            writer.close({"status": "completed", "wall_s": str(self.made)})
        return Run(path)


@pytest.fixture
def logs(tmp_path: Path, codecs: Mapping[str, Codec]) -> Logs:
    return Logs(tmp_path, codecs)


def rows(settings: Settings) -> list[tuple[str, str, str | None, str | None]]:
    return [(each.group, each.name, each.a, each.b) for each in settings.differences]


def test_equal_runs_have_no_difference_and_the_text_says_so(logs: Logs) -> None:
    settings = compare_settings(
        logs(label="one"), logs(started="now", label="two", command_line="platoon run formation --label two --out x")
    )
    assert (settings.differences, settings.notes, settings.names) == ((), (), ("one", "two"))
    assert str(settings) == f"A: one\nB: two\n{NOTHING_DIFFERS}"


@pytest.mark.parametrize(
    ("change", "row"),
    [
        ({"seed=2": ""}, ("scenario", "seed", "1", "2")),
        ({"platoon.gap_m=12.0": ""}, ("scenario", "platoon.gap_m", "10.0", "12.0")),
        ({"vehicles.1.x_m=1.5": ""}, ("scenario", "vehicles.1.x_m", "0.0", "1.5")),
        ({"vehicles.1.road.mu=0.5": ""}, ("scenario", "vehicles.1.road", "not set", "{mu = 0.5}")),
        ({'on_ecu_failure="continue"': ""}, ("scenario", "on_ecu_failure", '"end"', '"continue"')),
        ({"tracker.offset_free=false": ""}, ("scenario", "tracker.offset_free", "true", "false")),
        ({'buses={v2v="udp"}': ""}, ("scenario", "buses.v2v", None, '"udp"')),
        (
            {'road.mu={kind="step", at_s=1.0, before=0.9, after=0.3}': ""},
            ("scenario", "road.mu", "0.8", '{kind = "step", at_s = 1.0, before = 0.9, after = 0.3}'),
        ),
        ({"commit": "5678+"}, ("versions", "commit", "1234", "5678+")),
        ({"python": "3.12"}, ("versions", "python", "3.11.7", "3.12")),
        ({"fmu_guid": "{2}"}, ("versions", "FMU", "{1}", "{2}")),
        ({"version__numpy": "3"}, ("versions", "numpy", "2", "3")),
        ({"buses": "vcan"}, ("options", "buses", "udp", "vcan")),
        ({"buses": "udp:40001@eth0"}, ("options", "buses", "udp", "udp:40001@eth0")),
        ({"clock": "realtime"}, ("options", "clock", "lockstep", "realtime")),
        ({"ecu__tracker": "b:T"}, ("options", "ecu tracker", "a:T", "b:T")),
        ({"ecu__veh2.tracker": "b:T"}, ("options", "ecu veh2.tracker", "a:T", "b:T")),
        ({"resimulated": "veh1.tracker"}, ("options", "resimulated", None, "veh1.tracker")),
        (
            {"command_line": "platoon run formation --clock realtime --out=b.mcap --live"},
            ("options", "command", "platoon run formation", "platoon run formation --clock realtime"),
        ),
        ({"host": "there"}, ("machine", "host", "here", "there")),
        ({"platform": "macOS"}, ("machine", "platform", "Linux", "macOS")),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
def test_each_setting_is_named_with_both_values(
    logs: Logs, change: dict[str, str], row: tuple[str, str, str | None, str | None]
) -> None:
    overrides = [text for text, value in change.items() if not value]
    metadata = {name: value for name, value in change.items() if value}
    settings = compare_settings(logs(), logs(*overrides, **metadata))
    assert (rows(settings), settings.notes) == ([row], ())
    assert f"{row[1]}  A: {row[2] or '–'}  B: {row[3] or '–'}" in str(settings)


def test_files_are_compared_by_their_content(logs: Logs) -> None:
    settings = compare_settings(
        logs(files={"vehicle.dbc": b"1", "scenario.txt": b"2", "command_line.txt": b"3"}),
        logs(files={"vehicle.dbc": b"4", "scenario.txt": b"2", "command_line.txt": b"5"}),
    )
    ((group, name, a, b),) = rows(settings)
    assert (group, name) == ("versions", "vehicle.dbc")
    assert (a, b) == ("sha256 6b86b273ff34fce1", "sha256 4b227777d4dd1fc6")
    # Without a GUID, the FMU is known by its description.
    without = {name: value for name, value in METADATA.items() if name != "fmu_guid"}
    descriptions = [logs(metadata=without, files={"modelDescription.xml": data}) for data in (b"1", b"4")]
    assert [each.name for each in compare_settings(*descriptions).differences] == ["modelDescription.xml"]


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ((LOSS, NOISE), (LOSS, NOISE), []),
        ((NOISE,), (LOSS, NOISE), [("faults.0", None, LOSS)]),
        ((LOSS, NOISE), (LOSS,), [("faults.1", NOISE, None)]),
        ((LOSS,), (OUTAGE,), [("faults.0", LOSS, None), ("faults.0", None, OUTAGE)]),
        ((LOSS,), (LOSS.replace("0.5", "0.25"),), [("faults.0 (frame_loss) probability", "0.5", "0.25")]),
        (
            (LOSS,),
            (NOISE, LOSS.replace("0.5", "0.25")),
            [("faults.0 (frame_loss; faults.1 in B) probability", "0.5", "0.25"), ("faults.0", None, NOISE)],
        ),
        ((LOSS, LOSS), (LOSS,), [("faults.1", LOSS, None)]),
        (
            (LOSS, NOISE),
            (NOISE, LOSS),
            [("faults, order", '["frame_loss", "sensor_noise"]', '["sensor_noise", "frame_loss"]')],
        ),
        ((OUTAGE,), (OUTAGE.replace(", vehicle=2", ""),), [("faults.0 (v2v_outage) vehicle", "2", "not set")]),
    ],
)
def test_faults_are_compared_by_item(
    logs: Logs, a: tuple[str, ...], b: tuple[str, ...], expected: list[tuple[str, str | None, str | None]]
) -> None:
    settings = compare_settings(*(logs(f"faults=[{', '.join(faults)}]") for faults in (a, b)))
    texts = [(name, *(value and value.replace("=", " = ") for value in values)) for name, *values in expected]
    assert [(each.name, _in_order(each.a), _in_order(each.b)) for each in settings.differences] == [
        (name, *(_in_order(value) for value in values)) for name, *values in texts
    ]


def _in_order(value: str | None) -> str | None:
    """A table with its keys sorted."""
    return ", ".join(sorted(value.strip("{}").split(", "))) if value and value.startswith("{") else value


def test_a_vehicle_that_one_run_has_is_one_item(logs: Logs) -> None:
    settings = compare_settings(logs(), logs(scenario="five"))
    names = [each.name for each in settings.differences]
    assert names[-2:] == ["vehicles.3", "vehicles.4"]
    assert all(each.a is None for each in settings.differences[-2:])
    assert "vehicles.0.x_m" in names


def test_what_an_older_log_does_not_record_is_a_note(logs: Logs) -> None:
    old = logs(metadata={"scenario": "formation", "clock": "lockstep"})
    settings = compare_settings(logs(), old)
    assert settings.differences == ()
    (note,) = settings.notes
    assert note.startswith("Not recorded in B: commit, python, FMU, ")
    assert str(settings).endswith(note)
    reference = Run(Path(__file__).parents[1] / "reference" / "formation.mcap")
    assert next(each.name for each in compare_settings(logs(), reference).differences) == "duration_s"


@pytest.mark.parametrize("text", [b"", b"no = toml = ", b"\xff"])
def test_without_a_readable_scenario_the_rest_is_compared(logs: Logs, text: bytes) -> None:
    settings = compare_settings(logs(), logs(text=text, host="there"))
    assert [each.name for each in settings.differences] == ["host"]
    assert settings.notes == ("The scenarios are not compared: B has none that can be read.",)


def test_a_scenario_of_another_version_is_compared_key_by_key(logs: Logs) -> None:
    text = load("formation").toml().replace("gap_m = 10.0", "gap_m = 11.0\nwidth_m = 3.0").encode()
    found = {row[1]: row[2:] for row in rows(compare_settings(logs(), logs(text=text)))}
    assert found["platoon.width_m"] == (None, "3.0")
    assert found["platoon.gap_m"] == ("10.0", "11.0")


def test_both_from_a_changed_checkout_may_differ_in_more(logs: Logs) -> None:
    settings = compare_settings(logs(commit="1234+"), logs(commit="1234+"))
    assert settings.notes == ("Both ran from a checkout with changes since its commit, which may differ.",)


def test_a_log_from_elsewhere_cannot_be_compared(logs: Logs) -> None:
    settings = compare_settings(logs(), logs(metadata={}))
    assert (settings.comparable, settings.differences) == (False, ())


def test_the_text_lists_a_limited_number_and_shows_no_control_characters(logs: Logs) -> None:
    names = {f"version x{number}": "1" for number in range(MOST_SHOWN + 5)}
    a, b = (logs(**{name: value + more for name, value in names.items()}) for more in ("", "\x1b[31m\n" + "y" * 300))
    text = str(compare_settings(a, b))
    assert text.endswith("  and 5 more")
    assert "\x1b" not in text
    assert max(map(len, text.splitlines())) < 300
    assert len(compare_settings(a, b).differences) == MOST_SHOWN + 5


def test_runs_are_named_by_label_or_file(logs: Logs) -> None:
    soft, stiff, none, other = logs(label="soft"), logs(label="stiff"), logs(), logs(label="soft")
    assert names_of(soft, stiff) == ("soft", "stiff")
    assert names_of(soft, none) == ("soft", "3.mcap")
    assert names_of(none, logs()) == ("3.mcap", "5.mcap")
    assert names_of(soft, other) == ("1.mcap", "4.mcap")
    assert names_of(none, none) == (str(none.path), str(none.path))
    assert label_of(logs(label=f"\x1b[31m{'z' * 500}\n")) == f"{'z' * 59}…"


def test_the_label_of_a_resimulation_names_its_origin(logs: Logs) -> None:
    assert resim_label(logs(label="soft"), ["veh1.tracker"]) == "soft, resim of veh1.tracker"
    assert resim_label(logs(), ["veh1.tracker", "veh1.planner"]) == "2.mcap, resim of 2 ECUs"
    assert len(resim_label(logs(label="z" * 60), ["veh1.tracker"])) == 60


def test_of_many_names_that_are_not_recorded_the_note_lists_some(logs: Logs) -> None:
    number = 2_000
    names = {f"version {each}": "1" for each in range(number)}
    (note,) = compare_settings(logs(**names), logs()).notes
    assert note.endswith(f" and {number - 30} more.")
