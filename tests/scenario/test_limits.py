"""Too much of everything in a scenario: one message with the limit, and the DBC files are read once."""

import pytest

from bench.errors import BadInput
from bench.scenario import load
from bench.scenario.errors import MOST_PROBLEMS
from bench.scenario.loading import LONGEST_LINE, MOST_BYTES, SCENARIO_DIR, from_log
from bench.scenario.model import LONGEST_DESCRIPTION, MOST_FAULTS

FORMATION = (SCENARIO_DIR / "formation.toml").read_text()
FAULT = '\n[[faults]]\nkind = "ecu_crash"\necu = "{ecu}"\nat_s = 1.0\n'


def described(text: str) -> str:
    return text + "\n".join(line for line in FORMATION.splitlines() if not line.startswith("description"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            FORMATION + FAULT.format(ecu="veh1.tracker") * 20_000,
            "faults has 20000 entries; allowed: a list of 0 to 1000",
        ),
        (FORMATION + "\n[[vehicles]]\nx_m = 0.0\ny_m = 0.0\nspeed_mps = 20.0\n" * 20_000, "1 to 16 entries"),
        (
            described('description = "' + "x" * 2_000_000 + '"\n'),
            "line 1 has 2000016 characters; allowed: at most 20000",
        ),
        (described('description = """' + "x\n" * 5_000 + '"""\n'), "allowed: text of at most 4000 characters"),
        ("# " + "x\n" * MOST_BYTES, f"may have at most {MOST_BYTES}"),
        ("a = " + "[" * 10_000, "not TOML"),
        ("a = " + "{a=" * 6_000, "not TOML"),
        (".".join(["a"] * 100_000) + " = 1\n", f"line 1 has .* allowed: at most {LONGEST_LINE}"),
        (".".join(["a"] * 9_000) + " = 1\n", "nested too deeply"),
        ("seed = " + "9" * 10_000, "not TOML"),
        (FORMATION + "".join(f"\nk{number} = 1" for number in range(1_000)), "has 1000 errors"),
    ],
    ids=range(11),
)
def test_a_scenario_with_too_much_is_refused(tmp_path, text, message):
    path = tmp_path / "much.toml"
    path.write_text(text)
    with pytest.raises(BadInput, match=message) as refused:
        load(path)
    assert len(str(refused.value)) < 10_000


def test_a_message_lists_some_errors_and_counts_the_others(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(FORMATION + FAULT.format(ecu="veh9.tracker") * 100)
    with pytest.raises(BadInput) as refused:
        load(path)
    first, *lines, last = str(refused.value).splitlines()
    assert first.endswith("has 100 errors:")
    assert len(lines) == MOST_PROBLEMS
    assert last == f"  and {100 - MOST_PROBLEMS} more"


def test_the_dbc_files_are_read_once_for_all_faults(tmp_path, monkeypatch):
    from bench.scenario import fault_targets

    read = []
    original = fault_targets.load_codecs
    fault_targets._bench.cache_clear()
    monkeypatch.setattr(fault_targets, "load_codecs", lambda vehicles: (read.append(vehicles), original(vehicles))[1])
    path = tmp_path / "most.toml"
    fault = '\n[[faults]]\nkind = "frame_loss"\nbus = "veh1"\nmessage = "VehicleMotion"\nat_s = 1.0\n'
    path.write_text(FORMATION + fault * MOST_FAULTS)
    assert len(load(path).faults) == MOST_FAULTS
    assert len(read) == 1


@pytest.mark.parametrize("key", [".".join(["a"] * 5_000), "a" * 100_000, "platoon." * 5_000 + "a"])
def test_a_key_that_is_set_may_be_of_any_length(key):
    with pytest.raises(BadInput):
        load("formation", [f"{key}=1"])


@pytest.mark.parametrize("value", ["[" * 10_000, "9" * 10_000, "nan", "inf", "-inf", "1e999", "1e9", "{a=" * 5_000])
def test_a_value_that_is_set_is_checked(value):
    with pytest.raises(BadInput):
        load("formation", [f"duration_s={value}"])


def test_a_logs_scenario_is_limited_too():
    long = load("formation").model_copy(update={"description": "x" * 2_000_000})
    with pytest.raises(ValueError, match="at most"):
        from_log(long.toml() + "# " + "x" * MOST_BYTES)
    with pytest.raises(ValueError, match="nested too deeply"):
        from_log(".".join(["a"] * 5_000) + " = 1\n")
    # Earlier versions had no limit.
    assert len(from_log(long.toml()).description) == LONGEST_DESCRIPTION
