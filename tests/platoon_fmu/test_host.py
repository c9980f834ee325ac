"""The FMU in a host written in C: a whole life gives fmpy's bits, misuse is refused, and no checker finds anything."""

from __future__ import annotations

import ctypes
import math
import sys

import pytest

from platoon_fmu.importer import Instance, Kind

from .hosting import PACKED, SANITIZED, VALGRIND, workshop_in

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the host loads binaries as Linux does")

BOTH = pytest.mark.parametrize("kind", Kind, ids=["ME", "CS"])
SOLVERS = pytest.mark.parametrize("solver", [1, 2], ids=["RK4", "DP5"])
OK, DISCARD, ERROR = 0, 2, 3
STEP = 0.013


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    return workshop_in(tmp_path_factory.getbasetemp())


# ---- the host's life.c once more, with fmpy ----


class Life:
    """Drives an instance as life.c does, and keeps what that prints."""

    def __init__(self, car):
        self.car, self.kind, self.reals, self.texts = car, car.kind, {}, {}
        variables = car.fmu.description.modelVariables
        self.states = list(self.car.state_names)
        derivatives = [v.name for v in variables if v.derivative is not None]
        outputs = [v.name for v in variables if v.causality == "output" and v.name not in self.states]
        self.unknowns = [*self.states, *derivatives, *outputs]
        self.inputs = [v.name for v in variables if v.causality == "input"]
        parameters = [v.name for v in variables if v.causality == "parameter" and not v.name.startswith("solver")]
        self.beginning, self.running = [*self.inputs, *parameters], [*self.states, *self.inputs]

    def keep(self, label, names=None):
        self.reals[label] = list(self.car.get(*(names or self.unknowns)))

    def keep_directional(self, label, knowns):
        seed = [0.125 * (i + 1) for i in range(len(knowns))]
        self.reals[label] = list(self.car.directional_derivative(self.unknowns, knowns, seed))

    def initialize(self, time, tolerance=1e-7, **more):
        self.car.time = time
        experiment = {"tolerance": tolerance, "startTime": time, **more}
        if self.car.fmu.version == 2:
            self.car.raw.setupExperiment(**experiment)
            experiment = {}
        self.car.raw.enterInitializationMode(**experiment)

    def settle(self):
        update = self.car.raw.newDiscreteStates if self.car.fmu.version == 2 else self.car.raw.updateDiscreteStates
        while update()[0]:
            pass
        self.car.raw.enterContinuousTimeMode()

    def exit_initialization(self):
        self.car.raw.exitInitializationMode()
        if self.kind is Kind.MODEL_EXCHANGE:
            self.settle()

    def drive(self, i):
        self.car.set(
            steering_angle=0.01 * (i % 7) - 0.02,
            wheel_torque_fl=40.0 * (i % 3),
            wheel_torque_rr=-25.0 * (i % 4),
            force_x=100.0 * i,
        )

    def advance(self, h):
        if self.kind is Kind.CO_SIMULATION:
            self.car.step(h)
            return
        t, x = self.car.time, self.car.states()

        def slope(time, at):
            self.car.set_states(at, time)
            return self.car.derivatives()

        k1 = slope(t, x)
        k2 = slope(t + h / 2, x + h / 2 * k1)
        k3 = slope(t + h / 2, x + h / 2 * k2)
        k4 = slope(t + h, x + h * k3)
        self.car.set_states(x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), t + h)

    def tune(self, **parameters):
        if self.kind is Kind.MODEL_EXCHANGE:
            self.car.raw.enterEventMode()
        self.car.set(parameters)
        if self.kind is Kind.MODEL_EXCHANGE:
            self.settle()

    def five_steps(self, label):
        for i in range(5):
            self.drive(i + 3)
            self.advance(STEP)
        self.keep(label)

    def keep_numbers(self):
        self.texts["solver"] = str(int(self.car["solver"]))
        self.keep("time", ["time"])
        n, prefix = len(self.unknowns), f"fmi{self.car.fmu.version}"
        if self.kind is Kind.MODEL_EXCHANGE:
            nominals = (ctypes.c_double * len(self.states))()
            getattr(self.car.raw, f"{prefix}GetNominalsOfContinuousStates")(
                self.car.raw.component, nominals, len(nominals)
            )
            self.reals |= {"nominals": list(nominals), "states": list(self.car.states())}
        elif self.car.fmu.version == 2:
            references, values = (ctypes.c_uint * n)(*self.car.references(self.unknowns)), (ctypes.c_double * n)()
            orders = (ctypes.c_int * n)(*([1] * n))
            self.car.raw.fmi2GetRealOutputDerivatives(self.car.raw.component, references, n, orders, values)
            self.reals["output derivatives"] = list(values)
        else:
            found = self.car.raw.getOutputDerivatives(self.car.references(self.unknowns), [1] * n)
            self.reals["output derivatives"] = list(found)

    def save_and_restore(self):
        time, state, content = self.car.time, self.car.save(), self.car.serialise()
        self.texts["bytes"] = content.hex()
        self.five_steps("went on")
        self.car.restore(state, time)
        self.five_steps("again")
        self.car.deserialise(content, time)
        self.five_steps("from bytes")
        self.car.discard(state)
        state, time = self.car.save(), self.car.time
        self.tune(M=1650.0, C_d=0.4)
        self.five_steps("tuned")
        self.car.restore(state, time)
        self.car.discard(state)

    def keep_own(self):
        if self.car.fmu.version == 2:
            self.texts["platform"] = "default"
            if self.kind is Kind.CO_SIMULATION:
                self.reals["reached"] = [self.car["time"]]
            return
        seed = [0.125 * (i + 1) for i in range(len(self.unknowns))]
        self.reals["adjoint"] = list(self.car.adjoint_derivative(self.unknowns, self.running, seed))
        if self.kind is Kind.MODEL_EXCHANGE:
            self.texts["numbers"] = f"{len(self.states)} 0"

    def run(self, solver):
        self.texts["version"] = self.car.fmu.description.fmiVersion
        self.car.raw.setDebugLogging(True, ["logAll"])
        self.car.set(v_x_start=20.0, v_y_start=0.3, gamma_start=0.1, mu=0.7, M=1800.0, solver=solver)
        self.texts["bytes before the start"] = self.car.serialise().hex()
        self.initialize(0.5, stopTime=10.0)
        self.keep("initial")
        self.keep_directional("initial directional", self.beginning)
        self.exit_initialization()
        for i in range(20):
            self.drive(i)
            if i == 10:
                self.tune(M=1700.0, C_d=0.5)
            self.advance(STEP)
            self.keep(f"step {i}")
        self.keep_directional("directional", self.running)
        self.keep_numbers()
        self.save_and_restore()
        self.keep_own()
        self.car.terminate()
        self.keep("terminated")
        self.car.reset()
        self.car.set(v_x_start=10.0)
        self.initialize(0.0)
        self.exit_initialization()
        self.five_steps("second run")


def bits(values):
    return [float(value).hex() for value in values]


def in_python(text):
    """Words of C, its hexadecimal floats as Python writes them."""
    return [float.fromhex(word).hex() if "0x" in word else word for word in text.split()]


def assert_is_the_life(output, fmu, kind, solver):
    with Instance(fmu, kind, "car") as car:
        life = Life(car)
        life.run(solver)
    assert len(life.reals) > 30
    for label, values in life.reals.items():
        assert bits(output.reals(label)) == bits(values), label
    for label, text in life.texts.items():
        assert output[label] == text, label
    assert output.all("logEvents") == life.car.said
    assert output.all("logStatusError") == []


@BOTH
@SOLVERS
def test_a_life_gives_the_bits_that_fmpy_gives(workshop, open_fmu, kind, solver):
    output = workshop.host(open_fmu, PACKED).run(kind, "life", solver)
    assert_is_the_life(output, open_fmu, kind, solver)
    assert bits(output.reals("went on")) == bits(output.reals("again")) == bits(output.reals("from bytes"))
    assert bits(output.reals("went on")) != bits(output.reals("tuned"))


class Watched(Instance):
    """Asks, in the third update of a step, to return at a time 2.5 ms later; as `watch` of host3.c does."""

    def _instantiate(self):
        self.n, self.rows = 0, []
        outputs = [v.valueReference for v in self.fmu.description.modelVariables if v.causality in ("output", "local")]
        self.raw.instantiate(
            loggingOn=True,
            logMessage=self._log_3,
            earlyReturnAllowed=True,
            requiredIntermediateVariables=outputs,
            intermediateUpdate=self._update,
        )

    def _update(self, _environment, time, *flags_and_results):
        *flags, requested, return_time = flags_and_results
        self.n += 1
        bits_of_flags = "".join(str(int(flag)) for flag in flags)
        self.rows.append((f"update {self.n}", f"{time.hex()} {bits_of_flags} {self['X'].hex()}"))
        requested[0], return_time[0] = self.n == 3, time + 0.0025


def test_an_importer_can_watch_a_step_and_end_it_early(workshop, open_fmu3):
    output = workshop.host(open_fmu3, PACKED).run(Kind.CO_SIMULATION, "life", 1)
    reached = 0.0
    with Watched(open_fmu3, Kind.CO_SIMULATION, "watched") as car:
        life = Life(car)
        car.start({"v_x_start": 20.0}, tolerance=1e-7)
        for i in range(2):
            car.n = i
            life.drive(i)
            *_, early, reached = car.raw.doStep(reached, 0.0085)
            assert early
            assert in_python(output[f"watched {i}"]) == [reached.hex(), "1"]
        assert bits(output.reals("watched")) == bits(car.get(*life.unknowns))
        theirs = [(label, text) for label, text in output.lines if label.startswith("update")]
        assert [[label, *in_python(text)] for label, text in theirs] == [
            [label, *text.split()] for label, text in car.rows
        ]
    # Nine steps of the solver would go 8.5 ms: the third step's end and 2.5 ms, then the second's.
    assert reached == pytest.approx(5 * 0.0085 / 9 + 2 * 0.0025, rel=1e-12)
    # Setting is never asked for, getting allowed, a step finished; returning possible but where it ends anyway.
    flags = [text.split()[1] for _, text in theirs]
    assert flags.count("0110") == 2
    assert flags.count("0111") == len(flags) - 2


# ---- misuse ----

COMMON = {
    "wrong token": "{00000000-0000-0000-0000-000000000000} is not this binary's",
    "a token with percent signs": "is not this binary's",
    "no token": "(none) is not this binary's",
    "no name": "the instance name is missing",
    "an empty name": "the instance name is missing",
    "step before the start": "not allowed in instantiated",
    "terminate before the start": "not allowed in instantiated",
    "exit no initialization": "not allowed in instantiated",
    "start at NaN": "the start time nan is not finite",
    "stop before the start": "the stop time -1 s",
    "stop at NaN": "the stop time nan s",
    "tolerate nothing": "the tolerance must be greater than 0, not 0",
    "no such solver": "cannot be set to 3; allowed: 1 to 2",
    "too long a solver step": "cannot be set to 1; allowed: 1e-06 to 0.01",
    "set an unknown reference": "no variable has the value reference 256",
    "set an unknown integer": "no variable has the value reference 256",
    "set an integer as a real": "is not of the type Real",
    "set a real as an integer": "is not of the type Enumeration",
    "set a state": "is neither an input nor a parameter",
    "set the time": "is neither an input nor a parameter",
    "set to NaN": "cannot be set to nan, which is not finite",
    "set to infinity": "cannot be set to -inf, which is not finite",
    "set no references": "an array is missing",
    "set no values": "an array is missing",
    "set no integer": "an array is missing",
    "initialize twice": "not allowed in initialization mode",
    "get an unknown reference": "no variable has the value reference 4294967295",
    "get an integer as a real": "is not of the type Real",
    "get a real as an integer": "is not of the type Enumeration",
    "get no references": "an array is missing",
    "get no values": "an array is missing",
    "get no integer": "an array is missing",
    "differentiate an input": "is not an unknown",
    "differentiate over a parameter": "is not a known now",
    "differentiate without a seed": "an array is missing",
    "differentiate into nothing": "an array is missing",
    "save nowhere": "a pointer for a result is missing",
    "restore nothing": "the state is missing",
    "serialize nothing": "is missing",
    "deserialize nothing": "the bytes are missing",
    "ask for a size nowhere": "a pointer for a result is missing",
    "serialize nowhere": "is missing",
    "serialize into too little": "bytes, not 8",
    "log an unknown category": "there is no log category noSuchCategory",
    "log no category": "there is no log category",
    "log no categories": "an array is missing",
    "set a start value late": "cannot be changed now",
    "set after the end": "not allowed in terminated",
    "terminate twice": "not allowed in terminated",
}

OF_KIND = {
    Kind.MODEL_EXCHANGE: {
        "set the solver late": "not allowed in continuous-time mode",
        "set the time to NaN": "the time is not finite",
        "set too few states": "continuous states, not 13",
        "get too many states": "continuous states, not 15",
        "get no states": "continuous states, not 0",
        "set a state to NaN": "not finite",
        "get states nowhere": "",
        "get derivatives nowhere": "",
        "get nominals nowhere": "",
        "tune within a step": "cannot be changed now",
        "settle within a step": "not allowed in continuous-time mode",
        "step a model": "not allowed in continuous-time mode of Model Exchange",
        "get an event indicator": "the model has none of these",
    },
    Kind.CO_SIMULATION: {
        "set the solver late": "cannot be changed now",
        "step by nothing": "must be greater than 0 s and finite, not 0 s",
        "step back": "must be greater than 0 s and finite, not -0.01 s",
        "step by NaN": "must be greater than 0 s and finite, not nan s",
        "step by infinity": "and finite, not inf s",
        "step from elsewhere": "a step must start at 0 s",
        "step from NaN": "a step must start at 0 s",
        "step past the stop time": "a step to 20 s would pass the stop time 10 s",
        "ask for second derivatives": "the order must be 1, not 2",
        "ask for an input's derivative": "is not an output",
        "ask for derivatives nowhere": "an array is missing",
        "ask for derivatives of no order": "an array is missing",
        "set states of a slave": "not allowed in step mode of Co-Simulation",
        "enter the event mode of a slave": "not allowed in step mode of Co-Simulation",
    },
}

OF_VERSION = {
    2: {
        "get a Boolean": "the model has none of these",
        "get a String": "the model has none of these",
    },
    3: {
        "instantiate with an event mode": "there is no event mode",
        "instantiate with an input as intermediate variable": "is not available in intermediate updates",
        "instantiate without the intermediate variables": "the intermediate variables are missing",
        "instantiate for scheduled execution": "this FMU is for Model Exchange and Co-Simulation",
        "instantiate without a log": "",
        "get two values of one variable": "there must be 1 values, not 2",
        "get an Int32": "the model has none of these",
        "set a Binary": "the model has none of these",
        "get a Clock": "the model has none of these",
        "enter the configuration mode": "not provided by this FMU",
        "enter the step mode": "not provided by this FMU",
        "activate a partition": "not provided by this FMU",
        "differentiate without an adjoint seed": "an array is missing",
    },
}

OF_BOTH = {
    (2, Kind.CO_SIMULATION): {
        "set a Boolean": "the model has none of these",
        "set a String": "the model has none of these",
        "set input derivatives": "inputs are held",
        "cancel a step": "not allowed in step mode",
        "ask for a time nowhere": "a pointer for a result is missing",
    },
    (2, Kind.MODEL_EXCHANGE): {},
    (3, Kind.CO_SIMULATION): {"step nowhere": "a pointer for a result is missing"},
    (3, Kind.MODEL_EXCHANGE): {"count states nowhere": "a pointer for a result is missing"},
}

# Of a Co-Simulation slave of FMI 2.0 whose steps are never pending.
DISCARDED = (
    "ask for the status of a step",
    "ask for an Integer status",
    "ask for a Boolean status",
    "ask for a String status",
)


@BOTH
def test_misuse_is_refused_with_its_reason_and_harms_nothing(workshop, open_fmu, kind):
    output = workshop.host(open_fmu, PACKED).run(kind, "misuse", 2)
    version = open_fmu.version
    expected = COMMON | OF_KIND[kind] | OF_VERSION[version] | OF_BOTH[version, kind]
    discarded = DISCARDED if (version, kind) == (2, Kind.CO_SIMULATION) else ()
    assert {label for label, _ in output.lines} == {*expected, *discarded, "the misused", "a fresh one"}
    for label, reason in expected.items():
        status, _, message = output[label].partition(" ")
        assert (int(status), reason in message) == (ERROR, True), f"{label}: {message}"
        # Every reason is given, but where there is no log to give it to.
        assert message.startswith(f"fmi{version}") or label == "instantiate without a log", label
    for label in discarded:
        assert int(output[label]) == DISCARD, label
    assert bits(output.reals("the misused")) == bits(output.reals("a fresh one"))
    assert all(math.isfinite(value) for value in output.reals("a fresh one"))


@BOTH
def test_damaged_bytes_are_no_state(workshop, open_fmu, kind):
    host = workshop.host(open_fmu, PACKED)
    output = host.run(kind, "damage")
    with Instance(open_fmu, kind) as car:
        size = len(car.serialise())
    assert output["shorter"] == f"{size} of {size} refused"
    assert output["flipped"] == f"{8 * size} of {8 * size} refused"
    for label, reason in (
        ("other kind", "the other interface type"),
        ("two in one", "not a state of this FMU"),
        ("zeros", "not a state of this FMU"),
        ("a state from the other kind", "another model or interface type"),
    ):
        assert output[label].startswith(f"{ERROR} "), label
        assert reason in output[label]
    assert bits(output.reals("before")) == bits(output.reals("restored"))


# ---- the same, watched ----


@BOTH
@pytest.mark.parametrize(("scenario", "number"), [("life", 2), ("misuse", 1), ("damage", 1)])
def test_valgrind_finds_nothing(workshop, open_fmu, kind, scenario, number):
    host = workshop.host(open_fmu, PACKED)
    assert host.run(kind, scenario, number, under=VALGRIND) == host.run(kind, scenario, number)


@BOTH
def test_the_sanitizers_find_nothing_in_the_sources(workshop, open_fmu, kind):
    host = workshop.host(open_fmu, SANITIZED)
    for solver in (1, 2):
        # Sources that are compiled without optimisation give the same bits.
        assert_is_the_life(host.run(kind, "life", solver), open_fmu, kind, solver)
    packed = workshop.host(open_fmu, PACKED)
    for scenario in ("misuse", "damage"):
        assert host.run(kind, scenario) == packed.run(kind, scenario)
