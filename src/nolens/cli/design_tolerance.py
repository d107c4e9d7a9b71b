"""`nolens design tolerance`."""

from typing import Any

from nolens.amounts import amount
from nolens.cli.command import command
from nolens.jobs import ToleranceOptions, study_tolerances


def _lines(summary: dict[str, Any]) -> list[str]:
    if "tolerances" in summary:
        return str(summary["tolerances"]).removesuffix("\n").split("\n")
    unit, rows = summary["unit"], summary["sensitivities"]
    lines = [
        f"{summary['criterion']} {amount(summary['nominal'], unit, digits=4)} with every parameter "
        "at its mean; change at − and + its tolerance, the worst first:"
    ]
    wide = max(len(row["parameter"]) for row in rows)
    for row in rows:
        mean = amount(row["mean"], digits=6)
        varied = f"{mean} ± {amount(row['tolerance'], row['unit'], digits=4)}"
        varied += f" ({row['tolerance_means']})"
        changes = (
            "not measurable" if row[key] is None else amount(row[key], unit, sign=True)
            for key in ("change_at_minus", "change_at_plus")
        )
        assumed = "  assumed" if row["note"].startswith("assumed") else ""
        lines.append(f"  {row['parameter']:<{wide}}  {varied:<28} {' / '.join(changes)}{assumed}")
    lines += _drawn(summary)
    if "solved" in summary:
        lines.append(_solved(summary["solved"]))
    return [*lines, f"{summary['seconds']:.1f} s"]


def _drawn(summary: dict[str, Any]) -> list[str]:
    unit, predicted = summary["unit"], summary["prediction"]
    lines = []
    if predicted["second_order_sigma"] is not None:
        lines.append(
            f"predicted: mean {amount(predicted['mean'], unit, digits=4)}, sigma "
            f"{amount(predicted['second_order_sigma'], unit)} ("
            f"{amount(predicted['root_sum_square_sigma'], unit)} by "
            "the root of the sum of squares alone)"
        )
    if summary["sigma"] is not None:
        lines.append(
            f"{summary['trials']} cameras drawn: mean "
            f"{amount(summary['mean'], unit, digits=4)}, sigma {amount(summary['sigma'], unit)}"
        )
    if summary["not_measurable"]:
        lines.append(f"{summary['not_measurable']} of them show no lines that could be measured")
    reached = (
        f"{level} {'none' if value is None else amount(value, unit, digits=4)}"
        for level, value in summary["levels"].items()
    )
    lines.append(f"this good or better: {', '.join(reached)}")
    if "yield" in summary:
        limit = amount(summary["limit"], unit, digits=4)
        lines.append(f"{_share(summary['yield'])} meet the limit of {limit}")
    return lines


def _share(found: dict[str, Any]) -> str:
    low, high = found["interval_95"]
    return f"{100 * found['share']:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %)"


def _solved(solved: dict[str, Any]) -> str:
    allowed = f"± {amount(solved['tolerance'], solved['unit'])}"
    wanted, reached = f"{100 * solved['wanted_yield']:g} %", _share(solved["reached"])
    if solved["verdict"] == "impossible":
        return (
            f"no tolerance of {solved['parameter']} gives a yield of {wanted}: even with none it "
            f"is {reached}"
        )
    if solved["verdict"] == "any":
        return (
            f"any tolerance of {solved['parameter']} up to {allowed}, the largest possible one, "
            f"gives a yield of {wanted}: {reached}"
        )
    return f"{solved['parameter']} may be {allowed} for a yield of {wanted}: {reached}"


tolerance = command(ToleranceOptions, study_tolerances, _lines, name="tolerance")
