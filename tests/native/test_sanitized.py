"""Native components with sanitizers in them, under attacks: the short form of `python -m tests.attacks.native`."""

from __future__ import annotations

import pytest

from ndob_fmu import load_model
from ndob_fmu.native.build import build_native, build_native_components
from tests.attacks.native import attack_of_fmi3, attacked, attacks, sanitized
from tests.helpers.needs import C_COMPILER

pytestmark = C_COMPILER
ATTACKS = {words[0]: words for words in attacks(calls=3000, trials=300, seed=97)}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sanitized")
    _, observer = build_native(load_model("flexible_joint"), folder / "plain")
    for fmu in (observer, *build_native_components(folder / "plain")):
        sanitized(fmu, folder)
    return folder


@pytest.mark.parametrize("name", ["tests.fuzz", "tests.attacks.native_states", "tests.attacks.texts"])
def test_an_attack_finds_nothing(fmus, name):
    assert attacked(ATTACKS[name], fmus) == 0


def test_random_calls_of_fmi_3_find_nothing(tmp_path):
    folder = tmp_path / "sanitized"
    folder.mkdir()
    for fmu in build_native_components(tmp_path / "plain", fmi=3):
        sanitized(fmu, folder)
    assert attacked(attack_of_fmi3(calls=2000, seed=97), folder) == 0


def test_a_sanitizer_ends_a_process_that_writes_past_an_array(fmus, tmp_path):
    """Without this the other tests would show nothing."""
    source = "fmi2Status fmi2Reset(fmi2Component component) {"
    spoilt = sanitized(
        fmus / "plain" / "TorsionSpring.fmu",
        tmp_path,
        lambda text: text.replace(source, f"{source} ((char *)calloc(1, 8))[8] = 1;"),
    )
    assert spoilt.exists()
    for name in ("Sensor", "Encoder"):
        (tmp_path / f"{name}.fmu").write_bytes((fmus / f"{name}.fmu").read_bytes())
    assert attacked(ATTACKS["tests.fuzz"], tmp_path) == 1
