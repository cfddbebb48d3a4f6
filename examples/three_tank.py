"""Three tanks in a row with an unknown inflow to the last; the levels of the first and the last are measured.

    area · ḣ₁ = first_pump − coupling · (h₁ − h₂)
    area · ḣ₂ = second_pump + coupling · (h₁ − h₂) − coupling · (h₂ − h₃)
    area · ḣ₃ = coupling · (h₂ − h₃) − outflow · h₃ / (h₃² + smoothing²)^¼ + unknown_inflow

The outflow follows Torricelli's law, outflow · √h₃, smoothed below the level `smoothing` so that it has a slope at
h₃ = 0. It enters where the unknown inflow does: the matched case, eq. (1), with n = 3, m = p = 2 and q = 1: more
outputs than unknown inputs, and no zeros. Levels in cm, flows in cm³/s, rates of change over minutes.

γ = outflow / √smoothing = 40 cm²/s: the slope of the outflow at h₃ = 0.
"""

import sympy

from ndob_fmu import Experiment, Model, ObserverDefaults, SignalDefaults

S, k = sympy.symbols("area coupling")

model = Model(
    name="ThreeTank",
    description="Three coupled tanks with an unknown inflow to the last",
    states=["first_level", "second_level", "third_level"],
    inputs=["first_pump", "second_pump"],
    outputs=["third_level", "first_level"],
    disturbances=["unknown_inflow"],
    A=[[-k / S, k / S, 0], [k / S, -2 * k / S, k / S], [0, k / S, -k / S]],
    B=[[1 / S, 0], [0, 1 / S], [0, 0]],
    C=[[0, 0, 1], [1, 0, 0]],
    G_d=[[0], [0], [1 / S]],
    f=lambda x, u, p: [
        -p.outflow * x.third_level / sympy.root(x.third_level**2 + p.smoothing**2, 4),
    ],
    parameters={"area": 154.0, "coupling": 8.0, "outflow": 20.0, "smoothing": 0.25},
    units={
        "first_level": "cm",
        "second_level": "cm",
        "third_level": "cm",
        "first_pump": "cm3/s",
        "second_pump": "cm3/s",
        "unknown_inflow": "cm3/s",
        "area": "cm2",
        "coupling": "cm2/s",
        "outflow": "cm2.5/s",
        "smoothing": "cm",
    },
    descriptions={
        "unknown_inflow": "unknown flow into the third tank; a leak is negative",
        "area": "cross-section of each tank",
        "coupling": "flow between neighbours per difference of their levels",
        "outflow": "flow out of the third tank per root of its level",
        "smoothing": "level below which the outflow falls linearly to zero",
    },
    lipschitz=40.0,
    disturbance_bound=50.0,
    x0=[40.0, 30.0, 20.0],
    xhat0=[35.0, 25.0, 25.0],
    observer=ObserverDefaults(alpha=0.02, pi_start=1.0, pi_end=1e6, pi_ramp_time=20.0),
    disturbance=SignalDefaults(kind="step", amplitude=15.0, start_time=60.0),
    experiment=Experiment(stop_time=120.0, step_size=0.05),
)
