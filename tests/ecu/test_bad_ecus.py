"""What the bench says of an ECU that somebody got wrong: what, where in their file, what is allowed."""

import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from bench.bus.codec import load_codecs
from bench.bus.network import EcuSlot
from bench.bus.states import ReferenceState
from bench.ecu.base import Health, Topic
from bench.ecu.checks import CheckedEcu, created
from bench.ecu.loading import load_class, load_classes
from bench.errors import BadInput, EcuError
from bench.scenario import load

SCENARIO = load("formation")
CODECS = load_codecs(3)
INSIDES = re.compile(r"<class '|__init__\(\)|importlib|<frozen|positional argument|own_folder|Traceback")
VALUES: Mapping[str, Mapping[str, float]] = {
    "VehicleMotion": {"VelocityX": 20.0, "VelocityY": 0.0, "YawRate": 0.0},
    "VehiclePosition": {"X": 0.0, "Y": 0.0},
    "VehicleAttitude": {"Yaw": 0.0, "Roll": 0.0},
    "Reference": {"VelocityX": 21.0, "YawRate": 0.2, "ReferenceState": ReferenceState.VALID},
}


def tracker(body: str, control: str = "return Command()") -> str:
    return f"""
from bench.ecu import *
class Mine(TrackerBase):
    {body or "pass"}
    def control(self, motion, reference):
        {control}
"""


def planner(plan: str) -> str:
    return (
        f"from bench.ecu import *\nclass Mine(PlannerBase):\n    def plan(self, pose, motion, peers):\n        {plan}\n"
    )


def plain(step: str, inputs: str = "()", name: str = "'mine'") -> str:
    return f"""
from bench.ecu import *
class Mine:
    def __init__(self, vehicle, scenario):
        self.name = {name}
        self.inputs = {inputs}
    def step(self, cycle, time_s, inputs, health):
        {step}
"""


def file_of(folder: Path, text: str) -> str:
    (folder / "my_ecu.py").write_text(text)
    return f"{folder}/my_ecu.py:Mine"


def ecu(spec: str, role: str = "tracker", vehicle: int = 1) -> CheckedEcu:
    return created(load_class(spec, role), spec, EcuSlot(role, vehicle), SCENARIO, CODECS)


def step(made: CheckedEcu) -> None:
    inputs = {topic: VALUES.get(topic.message) for topic in made.inputs}
    made.step(3, 0.03, inputs, Health())


@pytest.mark.parametrize(
    ("text", "role", "message"),
    [
        (tracker("").replace("Mine", "Minne"), "tracker", "has no class Mine; did you mean Minne? Its ECUs: Minne"),
        ("Mine = 3", "tracker", "has no class Mine"),
        ("class Mine: ...", "tracker", "it has no method step; derive it from TrackerBase or PlannerBase"),
        ("from bench.ecu import *\nclass Mine(TrackerBase): ...", "tracker", "method control(self, motion, reference)"),
        (
            "from bench.ecu import *\nclass Mine(TrackerBase):\n def controll(self, motion, reference): ...",
            "tracker",
            "lacks the method control(self, motion, reference) (it has controll) (LINE 2)",
        ),
        (tracker(""), "planner", "the class Mine is a tracker, not a planner; give it as tracker=FILE:Mine (LINE 3)"),
        (
            planner("..."),
            "tracker",
            "the class Mine is a planner, not a tracker; give it as planner=FILE:Mine (LINE 2)",
        ),
        (plain("return []", name="f'veh{vehicle}.planner'"), "tracker", "the class Mine is a planner, not a tracker"),
        (
            plain("return []", "(Topic(f'veh{vehicle}', 'Reference'),)"),
            "planner",
            "input Reference is what a planner sends itself, so it would wait for itself for ever (LINE 3)",
        ),
        (
            plain("return []", "(Topic('v2v', 'V2VPosition_2'),)"),
            "tracker",
            "input V2VPosition_2 is on bus v2v; this node has veh1",
        ),
        (
            plain("return []", "(Topic('veh1', 'VehicleMotoin'),)"),
            "tracker",
            "Reference; did you mean VehicleMotion? (LINE 3)",
        ),
        (
            plain("return []", "(Topic('v2v', 'V2VPosition_4'),)"),
            "planner",
            "input V2VPosition_4 does not exist on bus v2v; its DBC has ",
        ),
        (plain("return []", "('VehicleMotion',)"), "tracker", "inputs of Mine must be a tuple of Topic(bus, message)"),
        (plain("return []", "None"), "tracker", "inputs of Mine must be a tuple of Topic(bus, message)"),
        (plain("return []").replace("self.inputs", "self.input"), "tracker", "has no attribute inputs; see "),
        (
            plain("return []").replace("time_s, inputs, health", "inputs"),
            "tracker",
            "calls Mine.step(cycle, time_s, inputs, health), but it takes (cycle, inputs) (LINE 7)",
        ),
        (
            tracker("").replace("motion, reference)", "motion)"),
            "tracker",
            "calls Mine.control(motion, reference), but it takes (motion) (LINE 5)",
        ),
        (
            tracker("def __init__(self, gain): pass"),
            "tracker",
            "the bench calls Mine(vehicle, scenario), but it takes (gain) (LINE 3); write def __init__(self, ",
        ),
        (
            tracker("def __init__(self, vehicle, scenario): pass"),
            "tracker",
            "has no attribute name and inputs; call super().__init__(vehicle, scenario) in its constructor (LINE 3)",
        ),
        (
            tracker("def __init__(self, vehicle, scenario): self.gain = {}['gain']"),
            "tracker",
            "Mine(vehicle 1, scenario) failed: KeyError: 'gain' (LINE 4)",
        ),
        (tracker("def __init__(self, vehicle, scenario): quit()"), "tracker", "failed: SystemExit (LINE 4)"),
        (tracker("more_inputs = ('ActuatorStatus')"), "tracker", "more_inputs = 'ActuatorStatus' must be a tuple"),
        (tracker("more_inputs = ('ActuatorStats',)"), "tracker", "did you mean ActuatorStatus? (LINE 3)"),
        (tracker("more_inputs = (7,)"), "tracker", "must be a tuple of message names"),
        (tracker("more_inputs = ('TrackerStatus',)"), "tracker", "TrackerStatus is what a tracker sends itself"),
        (tracker("more_inputs = ('PlannerStatus',)"), "tracker", "PlannerStatus on bus veh1 has no alive counter"),
        ("import no_such_thing", "tracker", "No module named 'no_such_thing' (LINE 1)"),
        ("import my_ecus", "tracker", "did you mean my_ecu, beside my_ecu.py?"),
        ("x = 1\ny = x / 0", "tracker", "ZeroDivisionError: division by zero (LINE 2)"),
        ("x = 1\ndef broken(", "tracker", "SyntaxError: '(' was never closed (LINE 2)"),
        ("\n  x = 1\n y = 2", "tracker", "cannot be loaded: IndentationError: "),
        ("import sys\nsys.exit(3)", "tracker", "SystemExit: 3 (LINE 2)"),
        ("from bench.ecu import Trackerbase", "tracker", "cannot import name 'Trackerbase' from 'bench.ecu'"),
        ("x = '\x00'", "tracker", "cannot be loaded: "),
    ],
)
def test_a_wrong_class_is_refused_with_its_place(text: str, role: str, message: str, tmp_path: Path) -> None:
    spec = file_of(tmp_path, text)
    for _ in range(2):
        with pytest.raises(BadInput) as refused:
            ecu(spec, role)
        said = str(refused.value)
        file = str(tmp_path / "my_ecu.py")
        assert message in re.sub(rf"{re.escape(file)}, line", "LINE", said).replace(file, "FILE")
        assert said.startswith((f"ECU {spec!r}", "veh1."))
        assert not INSIDES.search(said)


@pytest.mark.parametrize(
    ("text", "role", "message"),
    [
        (
            tracker("", "return None"),
            "tracker",
            "Mine.control returned None; allowed: Command(steering_angle, torque_fl,",
        ),
        (tracker("", "pass"), "tracker", "Mine.control returned None"),
        (tracker("", "return 0.1, 2.0"), "tracker", "Mine.control returned a tuple; allowed: Command("),
        (tracker("", "return Reference(20.0)"), "tracker", "Mine.control returned a Reference; allowed: Command("),
        (tracker("", "return Command"), "tracker", "Mine.control returned a type; allowed: Command("),
        (tracker("", "return Command('left')"), "tracker", "a Command with steering_angle = 'left'; allowed: a number"),
        (tracker("", "return Command(0.1, None)"), "tracker", "a Command with torque_fl = None; allowed: a number"),
        (tracker("", "yield Command()"), "tracker", "Mine.control returned a generator; allowed: Command("),
        (tracker("", "return Command(steer=1)"), "tracker", "unexpected keyword argument 'steer'"),
        (tracker("", "return motion.vx"), "tracker", "AttributeError: 'Motion' object has no attribute 'vx'"),
        (tracker("", "return 1 / 0"), "tracker", "ZeroDivisionError: division by zero (LINE 6)"),
        (planner("return 20.0"), "planner", "Mine.plan returned 20.0; allowed: Reference(v_x, yaw_rate) (LINE 3)"),
        (planner("return Reference('fast')"), "planner", "a Reference with v_x = 'fast'; allowed: a number"),
        (
            tracker("", "self.show('TrackerTarget', VelX=1.0)"),
            "tracker",
            "VelX, which is not a signal of TrackerTarget; did you mean VelocityX? allowed: VelocityX, VelocityY,",
        ),
        (
            tracker("", "self.show('TrackerTargets', VelocityX=1.0)"),
            "tracker",
            "TrackerTargets, which is not a diagnostic message of a tracker; did you mean TrackerTarget? allowed: ",
        ),
        (tracker("", "self.show('SteeringCommand', SteeringAngle=1.0)"), "tracker", "not a diagnostic message of a tr"),
        (tracker("", "self.show('PlannerStatus', Slot=1.0)"), "tracker", "not a diagnostic message of a tracker"),
        (
            tracker("", "self.show('TrackerTarget', VelocityX='1'); return Command()"),
            "tracker",
            "it shows TrackerTarget with VelocityX = '1'; allowed: a number (LINE 6)",
        ),
        (
            tracker("", "self.received('ActuatorStatus')"),
            "tracker",
            "ActuatorStatus is not an input of Mine; add it to the class: more_inputs = ('ActuatorStatus',) (LINE 6)",
        ),
        (
            tracker("", "self.reception('ActuatorStats')"),
            "tracker",
            "ActuatorStats, which is not an input of Mine; did you mean ActuatorStatus? allowed: VehicleMotion,",
        ),
        (plain("pass"), "tracker", "its step returned None, not a list of Outgoing (LINE 7)"),
        (plain("return 'Reference'"), "tracker", "its step returned 'Reference', not a list of Outgoing"),
        (plain("return {'SteeringCommand': {}}"), "tracker", "a list with 'SteeringCommand'; allowed: Outgoing("),
        (plain("return [('veh1', 'SteeringCommand', {})]"), "tracker", "a list with a tuple; allowed: Outgoing("),
        (
            plain("return [Outgoing('veh1', 'SteeringCommand', 1.0)]"),
            "tracker",
            "SteeringCommand with 1.0; allowed: a dict",
        ),
        (
            plain("return [Outgoing('veh1', 'SteeringComand', {})]"),
            "tracker",
            "SteeringComand, which is not a message that veh1.tracker sends on veh1; did you mean SteeringCommand?",
        ),
        (plain("return [Outgoing('veh1', 'Reference', {})]"), "tracker", "not a message that veh1.tracker sends"),
        (plain("return [Outgoing('veh2', 'SteeringCommand', {})]"), "tracker", "on bus veh2; it sends on veh1"),
        (plain("return [Outgoing('v2v', 'V2VStatus_1', {})]"), "tracker", "on bus v2v; it sends on veh1"),
        (
            plain("return [Outgoing('veh1', 'SteeringCommand', {'SteerAngle': 0.1})]"),
            "tracker",
            "SteeringCommand with SteerAngle, which is not a signal; did you mean SteeringAngle? allowed: ",
        ),
        (
            plain("return [Outgoing('veh1', 'SteeringCommand', {'SteeringAngle': None})]"),
            "tracker",
            "SteeringCommand with SteeringAngle = None; allowed: a number",
        ),
        (plain("yield 1 / 0"), "tracker", "ZeroDivisionError: division by zero (LINE 8)"),
        (plain("raise ValueError"), "tracker", "veh1.tracker failed: ValueError (LINE 8)"),
    ],
)
def test_a_wrong_answer_is_explained_with_its_place(text: str, role: str, message: str, tmp_path: Path) -> None:
    made = ecu(file_of(tmp_path, text), role)
    with pytest.raises(EcuError) as failed:
        step(made)
    said = str(failed.value)
    assert message in said.replace(f"{tmp_path}/my_ecu.py, line", "LINE")
    assert f"({tmp_path}/my_ecu.py, line " in said
    assert said.startswith("veh1.")
    assert not INSIDES.search(said.replace("__init__() got an unexpected keyword", ""))


def test_an_error_names_the_lines_of_all_files_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("import math\ndef root(x):\n    return math.sqrt(x)\n")
    spec = file_of(tmp_path, "import helper\n" + tracker("", "return Command(helper.root(-1.0))"))
    with pytest.raises(EcuError) as failed:
        step(ecu(spec))
    error, caller = str(failed.value).splitlines()
    assert error.endswith(f"({tmp_path}/helper.py, line 3)")
    assert caller == f"  called in {tmp_path}/my_ecu.py, line 7: return Command(helper.root(-1.0))"


def test_a_warm_up_that_fails_is_said(tmp_path: Path) -> None:
    spec = file_of(tmp_path, tracker("@staticmethod\n    def warm_up(): 1 / 0\n"))
    with pytest.raises(BadInput, match=r"its warm_up failed: ZeroDivisionError: division by zero \(.*line 5\)"):
        load_classes([spec])


def test_right_answers_pass(tmp_path: Path) -> None:
    body = "import numpy as np; n = np.float32(0.5); return Command(n, 1, np.int64(2), True, n)"
    step(ecu(file_of(tmp_path, tracker("", body))))
    sent = ecu(f"{Path(__file__).parents[1]}/ecus/simple.py:CruisePlanner", "planner")
    assert Topic("v2v", "V2VPosition_2") in sent.inputs
    step(sent)


def test_a_file_without_a_class_has_its_ecus_named(tmp_path: Path) -> None:
    file = file_of(tmp_path, tracker("")).rpartition(":")[0]
    with pytest.raises(BadInput, match=r"write package.module:Class or .*; .*my_ecu.py has the ECUs Mine"):
        load_class(file)
