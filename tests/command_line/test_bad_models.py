"""A model that cannot be used is refused by `check` and by `build` with the same line, and nothing is written."""

import pytest

from ndob_fmu.cli import main
from ndob_fmu.errors import MESSAGE_LIMIT

CART = """
import sympy
from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults

fields = dict(
    name="Cart",
    states=["place", "rate"],
    inputs=["force"],
    outputs={"place": "place"},
    disturbances=["wind"],
    dynamics=lambda x, u, d, p: [x.rate, (u.force - p.drag * x.rate**2 + d.wind) / p.mass],
    parameters={"mass": 2.0, "drag": 0.1},
    ranges={"rate": (-1.0, 1.0)},
)
"""
MISTAKES = {
    "not affine in d": (
        "dynamics=lambda x, u, d, p: [x.rate, d.wind**2]",
        ["affine in the disturbances", "rate' = wind**2"],
    ),
    "not affine in d, a long expression": (
        "dynamics=lambda x, u, d, p: [x.rate, sum(sympy.sin(k * x.place) for k in range(90)) * d.wind**2]",
        ["affine in the disturbances", "rate' = wind**2*("],
    ),
    "an output that depends on d": (
        "outputs={'pull': lambda x, u, p: x.rate + sympy.Symbol('wind')}",
        ["outputs, pull", "does not depend on disturbances"],
    ),
    "an output with d as an argument": (
        "outputs={'pull': lambda x, u, d, p: d.wind}",
        ["outputs, pull", "four arguments"],
    ),
    "a derivative is missing": ("dynamics=lambda x, u, d, p: [x.rate]", ["2 expressions", "received 1"]),
    "a start value is missing": ("x0=[1.0]", ["Cart.x0: expected 2 finite numbers"]),
    "an empty range": ("ranges={'rate': (1.0, 1.0)}", ["ranges, rate", "the same or exchanged"]),
    "an undefined state": ("dynamics=lambda x, u, d, p: [x.speed, d.wind]", ["line 15 of cart.py", "received x.speed"]),
    "a misspelt state": (
        "dynamics=lambda x, u, d, p: [x.rat, d.wind]",
        ["dynamics, line 15 of cart.py: expected one of the states place, rate, received x.rat", "mean 'rate'?"],
    ),
    "a state by the wrong letter": (
        "dynamics=lambda x, u, d, p: [u.rate, d.wind]",
        ["expected the input force, received u.rate; likely cause: did you mean 'x.rate'?"],
    ),
    "an undefined parameter": (
        "dynamics=lambda x, u, d, p: [x.rate, p.gain * d.wind]",
        ["one of the parameters mass, drag", "p.gain", "not declared"],
    ),
    "an undefined symbol": (
        "dynamics=lambda x, u, d, p: [x.rate, sympy.Symbol('gain') * d.wind]",
        ["received the symbol 'gain'"],
    ),
    "an undefined name of Python": (
        "dynamics=lambda x, u, d, p: [x.rate, gain * d.wind]",
        ["dynamics, line 15 of cart.py", "name 'gain' is not defined"],
    ),
    "an undefined function": (
        "dynamics=lambda x, u, d, p: [x.rate, sympy.Function('friction')(x.rate) + d.wind]",
        ["received friction(rate)", "an undefined function"],
    ),
    "an invalid unit": ("units={'place': 'meterz'}", ["units, place: expected a unit of physics", "'meterz'"]),
    "a unit in words": ("units={'place': 'Volt'}", ["units, place: expected a unit of physics", "did you mean 'V'?"]),
    "an unknown field": ("disturbance_bounds=2.0", ["disturbance_bounds", "did you mean 'disturbance_bound'?"]),
    "an unknown field of a part": (
        "experiment=Experiment(step=0.1)",
        ["Experiment.__init__() got an unexpected keyword argument 'step'", "did you mean 'step_size'?"],
    ),
    "a function of SymPy that is not imported": (
        "disturbance_bound=sqrt(2.0)",
        ["name 'sqrt' is not defined", "`from sympy import sqrt` is missing"],
    ),
    "a unit that is no text": ("units={'place': 3}", ["Cart, text of place"]),
    "an unknown method": ("observer=ObserverDefaults(method=3)", ["Cart.observer.method: expected 1 or 2, received 3"]),
    "an order that is too high": ("observer=ObserverDefaults(disturbance_order=7)", ["0, 1, 2 or 3, received 7"]),
    "a negative rate": (
        "observer=ObserverDefaults(disturbance_rate=-1.0)",
        ["observer.disturbance_rate: expected one"],
    ),
    "a lag before time": ("observer=ObserverDefaults(lag=-1.0)", ["observer.lag: expected a finite number ≥ 0"]),
    "a pi that is no number": ("observer=ObserverDefaults(pi_end=float('nan'))", ["observer.pi_end"]),
    "an unknown disturbance": (
        "disturbance=SignalDefaults(kind='sinus')",
        ["disturbance.kind", "did you mean 'sine'?"],
    ),
    "a frequency that is no number": ("disturbance=SignalDefaults(frequency=float('nan'))", ["disturbance.frequency"]),
    "no step": ("experiment=Experiment(step_size=0.0)", ["experiment.step_size: expected a finite number > 0 (s)"]),
    "an end before the start": ("experiment=Experiment(stop_time=-1.0)", ["experiment.stop_time"]),
    "no slopes at the start": (
        "dynamics=lambda x, u, d, p: [x.rate, sympy.sqrt(x.place) * d.wind], ranges={}",
        ["Cart, linearised at its start values", "a root or a quotient of 0"],
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_check_and_build_refuse_it_with_the_same_line(mistake, tmp_path, capsys, monkeypatch):
    change, words = MISTAKES[mistake]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.py").write_text(f"{CART}model = Model(**(fields | dict({change})))\n", "utf-8")
    said = []
    for command in (["check", "cart.py"], ["build", "cart.py", "--out", "fmus"]):
        assert main(command) == 2
        out, err = capsys.readouterr()
        assert out == ""
        said.append([line for line in err.splitlines() if "still" not in line])
    (line,) = said[0]
    assert said[1] == [line]
    assert len(line) <= MESSAGE_LIMIT + len("ndob-fmu: ")
    for part in words:
        assert part in line
    assert not (tmp_path / "fmus").exists()


def test_the_plant_itself_passes(tmp_path):
    (tmp_path / "cart.py").write_text(f"{CART}model = Model(**fields)\n", "utf-8")
    assert main(["check", str(tmp_path / "cart.py")]) == 0
