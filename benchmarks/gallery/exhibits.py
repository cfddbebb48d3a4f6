"""The pages of the gallery in words: title, what is uncertain, and a text of each plant."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.estimator.plants import Plant
from benchmarks.estimator.records import Disturbance
from benchmarks.gallery.plants import gallery_plants


@dataclass(frozen=True)
class Exhibit:
    """A plant and its page.

    title: of the page
    uncertain: parameters that are known to 15 % only
    text: Markdown
    unit: of the picture's disturbances, and how many of the model's units one is
    steps: whether the disturbance is a step of D₀/2 for a third of the record, in place of sines
    time: unit of the picture's time axis, and how many seconds one is
    """

    title: str
    uncertain: tuple[str, ...]
    text: str
    unit: tuple[str, float] | None = None
    steps: bool = False
    time: tuple[str, float] = ("s", 1.0)

    def disturbance(self, plant: Plant) -> Disturbance | None:
        """Return d(t) of the record, None for sines."""
        if not self.steps:
            return None
        stop = plant.stop_time
        return lambda t: plant.nominal + plant.bounds * (0.5 if stop / 3.0 <= t < 2.0 * stop / 3.0 else 0.0)


EXHIBITS = {
    "two_link_arm": Exhibit(
        title="Robot arm with two links and two unknown torques",
        uncertain=("upper_arm_mass", "forearm_mass", "damping"),
        text="""\
Two links turn in the horizontal plane, as those of a SCARA robot. The inertia matrix M(q) depends on the elbow, and
so do the directions M(q)⁻¹ in which the loads act on the joints. The file writes M(q)⁻¹ times the torques as a
textbook does; nothing is brought into the paper's form by hand.

**Measured**: both angles, by 17-bit encoders every millisecond. **Unknown**: a torque on each joint, for example from
contact or from a load in the gripper. The drives' torques are known inputs.

**What to set**

- `noise_std`: an encoder rounds to 2π/2¹⁷ = 48 µrad. Rounding is like noise of 48/√12 = 14 µrad.
- `disturbance_bound`: 2 N·m and 1 N·m, a fifth of what the drives give.
- `disturbance_rate`: a sine of 1 Hz at the bound, D₀ (2π)². A contact is faster; it counts as a jump, which the
  observer tells from noise by itself.
- `ranges`: the elbow stops at ±2.8 rad. Inside, M(q) is far from singular.
- `xhat0_std`: 0.1 rad and 0.1 rad/s. Encoders know better; the first sample corrects it.
- `parameter_std` in the right picture: 15 % of both masses and of the damping. The masses matter where the arm
  accelerates: there the error bar grows, as wrong inertia cannot be told from a load.
""",
    ),
    "magnetic_levitator": Exhibit(
        title="Magnetic levitator",
        uncertain=("mass", "magnet_constant", "resistance", "inductance"),
        text="""\
An electromagnet holds a steel ball 10 mm below it. The pull grows with (current/gap)². So the ball is unstable, with
a pole at √(2 · gravity/gap) = 44 1/s, and the pull has no value at gap = 0.

**Measured**: the gap by a laser (5 µm) and the coil's current by a shunt (2 mA), every millisecond. **Unknown**: a
push on the ball. The voltage is the known input.

**What to set**

- `ranges`: the gap is between 2 and 20 mm. The observer never evaluates (current/gap)² elsewhere, also when a first
  estimate is wrong.
- `noise_std`: one number for each sensor, from their data sheets.
- `disturbance_bound`: 0.2 N, 40 % of the ball's weight. `disturbance_rate`: a sine of 2 Hz at the bound.
- `xhat0_std`: 1 mm for the gap, as the first estimate is 1 mm off.
- The step of 1 ms is short beside 1/(44 1/s) = 23 ms.
- `parameter_std` in the right picture: 15 % of mass, magnet, resistance and inductance. The weight is 0.49 N, so that
  15 % of mass and magnet are a force of up to 0.15 N. No estimator can tell it from a push with these sensors. The
  error bar says so.
""",
    ),
    "planar_quadrotor": Exhibit(
        title="Quadrotor in gusty wind",
        uncertain=("mass", "inertia"),
        text="""\
A quadrotor flies in a vertical plane. Its attitude turns the thrust, and gusts act on it with two forces and a
moment.

**Measured**: the position by motion capture (1 mm), the pitch (2 mrad) and its rate (5 mrad/s) by the inertial
sensors, every 5 ms. **Unknown**: the forces of the wind across and upwards, and its moment about the pitch axis. Both
thrusts are known inputs.

**What to set**

- `disturbances`: the moment is one of them, although only the forces may be of interest. Without it the equation of
  the pitch would be taken for exact, and rotors that differ by a percent would look like wind.
- `disturbance_bound`: 3 N, 1.5 N and 0.1 N·m. `disturbance_rate`: sines of 0.5 Hz at these bounds.
- `noise_std`: of each sensor. With 1 mm at 200 Hz the forces follow within some tenths of a second. With satellite
  positions of 1 cm the error bars grow, and the estimate becomes slower by itself.
- `ranges`: a pitch within ±1 rad, and thrusts from 0 to 15 N. The observer is tuned for thrusts in the middle.
- `parameter_std` in the right picture: 15 % of mass and inertia. A mass that is 15 % off is a constant error of the
  upward force of 1.8 N, more than its bound. The error bar reaches the bound, and says that only the mass would help.
""",
    ),
    "hydraulic_cylinder": Exhibit(
        title="Hydraulic cylinder in SI units",
        uncertain=("mass", "damping", "dead_volume", "bulk", "valve"),
        unit=("kN", 1e3),
        text="""\
A servo valve moves a piston with 500 kg. The two chambers are stiff springs whose volumes change with the position.
The flows follow the roots of the pressure differences. All is in SI units, so that 0.2 m stands beside 1e7 Pa.

**Measured**: the position (10 µm, magnetostrictive) and both pressures (20 kPa, 0.1 % of the supply), every
millisecond. **Unknown**: the load on the piston. The opening of the valve is the known input.

**What to set**

- `noise_std`: of each sensor in its own unit. Both pressures matter: they give the force on the piston at once.
- `disturbance_bound`: 10 kN, a quarter of what the cylinder gives. `disturbance_rate`: a sine of 1 Hz at the bound.
- `ranges`: stroke, speed, pressures between 0 and the supply, opening within ±1. The roots have no value outside.
- `smoothing` and `overlap` are parameters of the model: a root has no finite slope at 0, and the valve changes sides
  there. The smooth form is more accurate than the kink.
- `xhat0_std`: 1 MPa for the pressures; the first samples correct them.
- `parameter_std` in the right picture: 15 % of mass, damping, volumes, bulk modulus and valve. As both pressures are
  measured, bulk modulus and valve hardly matter for the load. The error bar shows what mass and damping leave.
""",
    ),
    "pmsm": Exhibit(
        title="Synchronous motor with permanent magnets (PMSM)",
        uncertain=("inertia", "friction", "resistance", "inductance", "flux"),
        steps=True,
        text="""\
A servo motor in the coordinates that turn with its rotor. Products of speed and currents couple the two axes.

**Measured**: the angle by a 14-bit encoder, and both currents (20 mA), every millisecond. The angle is counted on
over the turns. **Unknown**: the load torque. Both voltages are known inputs. In the record the load comes and goes in
a step, as when a machine tool enters its work piece.

**What to set**

- `noise_std`: rounding to 2π/2¹⁴ = 0.38 mrad counts as noise of 0.38/√12 = 0.11 mrad; 20 mA for the currents.
- `disturbance_bound`: 2 N·m. `disturbance_rate`: a sine of 2 Hz at the bound. A step is faster than that. The
  observer recognises it as a jump by the residuals of some samples, and follows.
- `ranges`: speed and currents, which limit the products.
- `xhat0_std`: 5 rad/s for the speed, which is not measured; the first milliseconds correct it.
- The electrical time constant, inductance/resistance = 2 ms, is near the step of 1 ms. `check` shows both in its row
  `pace`.
- `parameter_std` in the right picture: 15 % of all but the number of poles. The torque is flux times current: a flux
  that is 15 % off is a load that is 15 % off, and more while the motor accelerates.
""",
    ),
    "stirred_tank": Exhibit(
        title="Stirred tank with an unknown feed temperature",
        uncertain=("k0", "heat", "cooling"),
        time=("min", 60.0),
        text="""\
An exothermic reaction heats a stirred tank, and runs the faster, the hotter the tank is. At 350 K the reactor is
unstable without its controller.

**Measured**: the temperature of the tank alone (0.1 K, every second). **Unknown**: the temperature of the feed, and
the concentration, which is a state. The temperature of the coolant is the known input.

**What to set**

- `disturbance_nominal`: 350 K, the usual feed. The bound counts from there: 30 K. Without a nominal value the bound
  would have to be 380 K, and the observer would take jumps of 100 K for possible.
- `disturbance_rate`: a sine with a period of 10 minutes at the bound. The feed comes from a store and changes slowly.
- `ranges`: 300 to 420 K, and a concentration from 0 to 1 mol/l. exp(−activation/T) has a value there always.
- `noise_std`: 0.1 K. `xhat0_std`: 0.05 mol/l for the concentration, as the first estimate is that far off. Its error
  decays with the plant's own dynamics, as it is not measured.
- `parameter_std` in the right picture: 15 % of rate constant, heat of reaction and cooling. The reaction heats by as
  much as the feed cools, so that 15 % of it is 20 K of feed. No
  estimator can tell them apart. The error bar says so.
""",
    ),
}


def exhibits() -> list[tuple[Plant, Exhibit]]:
    """Return each plant with its page."""
    return [(plant, EXHIBITS[plant.name]) for plant in gallery_plants()]
