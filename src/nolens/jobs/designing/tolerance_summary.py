"""What a study of tolerances says, in values that JSON has."""

import math
from dataclasses import asdict
from typing import Any

from nolens.design.tolerances import Study, Yield
from nolens.jobs.designing.tolerance_options import ToleranceOptions
from nolens.jobs.designing.tolerance_ready import Ready


def summary_of(options: ToleranceOptions, ready: Ready, study: Study) -> dict[str, Any]:
    """Figures of a study, in values that JSON has; None where there is no finite one.

    Parameters
    ----------
    options
        What was asked for.
    ready
        What was computed.
    study
        What was found.
    """
    response, finite = study.response, study.figures[study.figures.isfinite()]
    prediction = response.predict()
    height, width = ready.patch.side_um
    summary: dict[str, Any] = {
        "camera": ready.camera.name,
        "criterion": ready.sharpness.name,
        "unit": ready.sharpness.unit,
        "model": options.model,
        "light": options.light,
        "patch_mm": [round(height * 1e-3, 4), round(width * 1e-3, 4)],
        "nominal": response.nominal,
        "sensitivities": [
            {
                "parameter": row.parameter.name,
                "distribution": row.parameter.distribution,
                "mean": row.parameter.middle,
                "tolerance": row.parameter.tolerance,
                "tolerance_means": row.parameter.tolerance_means,
                "unit": row.parameter.unit,
                "change_at_minus": _finite_or_none(row.minus),
                "change_at_plus": _finite_or_none(row.plus),
                "linear": _finite_or_none(row.linear),
                "quadratic": _finite_or_none(row.quadratic),
                "note": row.parameter.note,
            }
            for row in response.sensitivities
        ],
        "budget": [asdict(line) for line in study.budget],
        "prediction": {
            "mean": _finite_or_none(prediction.mean),
            "root_sum_square_sigma": _finite_or_none(prediction.linear_sigma),
            "second_order_sigma": _finite_or_none(prediction.sigma),
        },
        "trials": len(study.figures),
        "not_measurable": len(study.figures) - len(finite),
        "mean": _finite_or_none(float(finite.mean())) if len(finite) else None,
        "sigma": _finite_or_none(float(finite.std())) if len(finite) > 1 else None,
        "levels": {f"{100 * k:.0f} %": _finite_or_none(v) for k, v in study.levels.items()},
        "limit": study.limit,
    }
    if study.passed is not None:
        summary["yield"] = _yield_summary(study.passed)
    if study.solved is not None:
        name, wanted, allowed = study.solved
        unit = next(each.unit for each in ready.parameters if each.name == name)
        summary["solved"] = {
            "parameter": name,
            "wanted_yield": wanted,
            "verdict": allowed.verdict,
            "tolerance": allowed.tolerance,
            "unit": unit,
            "reached": _yield_summary(allowed.reached),
        }
    return summary


def _yield_summary(found: Yield) -> dict[str, Any]:
    return {
        "share": found.share,
        "passed": found.passed,
        "trials": found.trials,
        "interval_95": list(found.interval()),
    }


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
