"""The report of `benchmarks.margin_knob`: tables and a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks import report
from benchmarks.timing import QUIET_CORES

# Okabe and Ito's palette, told apart by every eye.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
INK = "#444444"


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    errors = numbers["errors"]
    tables = "\n\n".join(
        f"## {dtype}\n\n{_table(numbers, dtype)}"
        for dtype in _distinct(errors, "dtype")
    )
    differs = max(e["reference_differs"] for e in errors)
    return f"""\
# The margin's knob

{numbers["pairs"]:,} pairs of each kind (seed {numbers["seed"]}). Errors relative to \
max(1, growth distance), against the truth of the same rounded numbers in extended \
precision; on {numbers["checked"]:,} pairs of each kind that differs from bisection by \
{differs:.1e} at most. "False overlap": margin <= 0 though \
separated, of the separated pairs; "false separated": margin > 0 though overlapping, \
of the overlapping pairs, and the largest such margin. M pairs/s: under vmap on \
arrays (N, 3); without branches it is the same for every kind.
{_warning(numbers["rates"])}
{tables}

{report.machine_lines(numbers["machine"])}"""


def _warning(rates: list[dict[str, Any]]) -> str:
    cores = max(r["cores_busy_with_others"] for r in rates)
    if cores <= QUIET_CORES:
        return ""
    return f"\n**Disturbed:** other processes kept {cores:.2f} cores busy.\n"


def _table(numbers: dict[str, Any], dtype: str) -> str:
    header = (
        *("scene", "steps", "50 %", "99 %", "99.9 %", "max"),
        *("false overlap, %", "false separated, %", "by at most", "M pairs/s"),
    )
    entries = [e for e in numbers["errors"] if e["dtype"] == dtype]
    return report.table(header, [_row(e, _rates(numbers, dtype)) for e in entries])


def _row(entry: dict[str, Any], rates: list[float]) -> tuple[str, ...]:
    false_margin = max(0.0, entry["largest_false_margin"])
    return (
        entry["scene"],
        str(entry["steps"]),
        *(_scientific(x) for x in entry["error"].values()),
        _percent(entry["false_overlap"]),
        _percent(entry["false_separated"]),
        _scientific(false_margin),
        f"{rates[entry['steps']] / 1e6:.1f}",
    )


def _scientific(x: float) -> str:
    return f"{x:.1e}" if x else "0"


def _percent(share: float) -> str:
    """Two digits; "0" means none at all."""
    return f"{100 * share:.2g}" if share else "0"


def _rates(numbers: dict[str, Any], dtype: str) -> list[float]:
    """Pairs a second, by steps."""
    return [r["pairs_per_second"] for r in numbers["rates"] if r["dtype"] == dtype]


def _distinct(entries: list[dict[str, Any]], key: str) -> list[Any]:
    return list(dict.fromkeys(e[key] for e in entries))


def draw(numbers: dict[str, Any], file: Path) -> None:
    """Errors over steps, with the rate that each count of steps leaves."""
    # Here, so that the tables do not need matplotlib.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.2), layout="constrained")
    dtypes = _distinct(numbers["errors"], "dtype")
    panels = figure.subplots(1, len(dtypes), squeeze=False)[0]
    for axes, dtype in zip(panels, dtypes, strict=True):
        _draw_errors(axes, numbers, dtype)
        _draw_rates(axes, _rates(numbers, dtype))
    _draw_legend(figure, panels[0])
    machine = numbers["machine"]
    figure.suptitle(
        f"{numbers['pairs']:,} pairs of each kind; "
        f"{machine['processor']}, {machine['cores']} cores, jax {machine['jax']}",
        fontsize=8,
        color=INK,
    )
    figure.savefig(file, dpi=160)


def _draw_errors(axes: Any, numbers: dict[str, Any], dtype: str) -> None:
    """The largest error as a line, the 99th percentile dotted; zeros left out."""
    entries = [e for e in numbers["errors"] if e["dtype"] == dtype]
    for kind, color in zip(_distinct(entries, "scene"), COLORS, strict=True):
        for quantity, style in (("max", "o-"), ("99", "o:")):
            points = [
                (e["steps"], e["error"][quantity])
                for e in entries
                if e["scene"] == kind and e["error"][quantity] > 0
            ]
            label = kind if quantity == "max" else None
            axes.semilogy(
                *zip(*points, strict=True), style, color=color, ms=4, label=label
            )
    axes.set_xticks(_distinct(entries, "steps"))
    axes.set_xlabel("steps")
    axes.set_ylabel("error relative to max(1, growth distance)")
    axes.set_title(f"{dtype} (above: million pairs a second)", fontsize=10, pad=26)
    axes.grid(color="#e4e4e4", lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_rates(axes: Any, rates: list[float]) -> None:
    for steps, rate in enumerate(rates):
        axes.annotate(
            f"{rate / 1e6:.0f}",
            (steps, 1.0),
            (0, 6),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            fontsize=9,
            color=INK,
        )


def _draw_legend(figure: Any, axes: Any) -> None:
    """Kinds by colour, quantities by style."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    styles = {"largest error": "-", "99th percentile": ":"}
    handles += [Line2D([], [], color=INK, ls=style) for style in styles.values()]
    figure.legend(
        handles,
        [*labels, *styles],
        loc="outside lower center",
        ncols=len(handles),
        frameon=False,
        fontsize=8,
    )
