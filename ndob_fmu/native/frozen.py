"""A step with a frozen gain on the numbers of a state as they lie in memory: `frozen_step`, for `component/sampled.c`.

It does what the translated `step_converged` does for r ≥ 1, without taking the state apart and putting it together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import accumulate, takewhile

from ndob_fmu.runtime.step.filter_state import FilterMemory, SampledObserverState


def frozen_step_text(gain: Sequence[str], counts: Mapping[str, int], inputs: int, outputs: int) -> str:
    """Return the C functions `is_frozen_for` and `frozen_step`.

    gain: fields of the gain, as the printed function takes them
    counts: of the numbers in each field of `ObserverStep`, in their order
    inputs, outputs: of the plant
    """
    place_in_result = dict(zip(counts, _starts(list(counts.values())), strict=True))
    arrays = [one.name for one in fields(SampledObserverState) if one.name != "memory"]
    sizes = [counts["d_hat" if name == "d_std" else name] for name in arrays]
    place = dict(zip(arrays, _starts(sizes), strict=True))
    taken = "".join(f"common->gain.{field}->p, " for field in gain)
    written = "".join(
        f"    memcpy(state + {place[name]}, {source}, {size} * sizeof(double));\n"
        for name, size in zip(arrays, sizes, strict=True)
        for source in [f"result + {place_in_result[name]}" if name in place_in_result else f"common->gain.{name}->p"]
    )
    before = _before_end(outputs)
    return (
        "/* Whether a state, which ends at `end`, has a gain that is frozen for a step, a tuning and a noise. */\n"
        "static bool is_frozen_for(const double *end, double step, double tuned_at, nd noise) {\n"
        f"    const double *told = end - {before['frozen_noise']};\n"
        f"    if (end[-{before['converged']}] == 0.0 || end[-{before['step']}] != step"
        f" || end[-{before['tuned_at']}] != tuned_at) return false;\n"
        f"    for (int i = 0; i < {outputs}; i++)\n"
        "        if (told[i] != noise->p[i]) return false;\n"
        "    return true;\n"
        "}\n"
        "/* Advance a state from a sample that is not suspicious; false, with nothing written, for all else. */\n"
        "static bool frozen_step(nd_arena *arena, const ConvergedStep *common, const double *u, const double *y,\n"
        "                        double H, double *state, double *outputs) {\n"
        f"    double inputs[{inputs + outputs}], result[{sum(counts.values())}];\n"
        f"    memcpy(inputs, u, {inputs} * sizeof(double));\n"
        f"    memcpy(inputs + {inputs}, y, {outputs} * sizeof(double));\n"
        f"    if (observer_step(state, inputs, state + {place['squares']}, common->constants->p, {taken}H, result))\n"
        "        return false;\n"
        f"    nd_array squares = nd_around({outputs}, result + {place_in_result['squares']});\n"
        "    if (!converged_step_squares_are_usual(arena, &squares, common->least_squares)) return false;\n"
        f"{written}"
        f"    memcpy(outputs, result + {place_in_result['outputs']}, {counts['outputs']} * sizeof(double));\n"
        "    return true;\n"
        "}\n"
    )


def _starts(counts: Sequence[int]) -> list[int]:
    return list(accumulate(counts, initial=0))[:-1]


def _before_end(outputs: int) -> dict[str, int]:
    """Return how far before the end of a state the last fields of its memory are, from `converged` on."""
    behind = takewhile(lambda name: name != "converged", (one.name for one in reversed(fields(FilterMemory))))
    names = [*behind, "converged"]
    return dict(zip(names, accumulate(outputs if name == "frozen_noise" else 1 for name in names), strict=True))
