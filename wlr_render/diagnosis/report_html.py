"""A diagnosis as one HTML page that needs no other file: what to do first, then the evidence."""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from wlr_render.diagnosis import pictures, report_tables
from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.gain import Gains
from wlr_render.diagnosis.report_parts import ReportPart, report_parts
from wlr_render.diagnosis.report_text import FIGURES, advice, verdict_sentence, warnings
from wlr_render.report.blocks import ReportTable, cell_text

_STYLE = Path(__file__).with_name("report.css")
_BAND_TEXT = (
    "Dots: mean of the readings in a bin, in the camera's image; grey band: how far noise alone would move such a mean "
    "(two standard errors). Grey line: what the rms of the readings has beyond noise (root of the difference of "
    "squares, zero within two standard errors); it shows what averages out. Stage positions are from the origin of "
    "the stage in the device's frame, x right, y up, z towards the wearer."
)
_MAP_TEXT = (
    "Each arrow is the mean of the readings around it, measured minus simulated. Arrows are drawn to the scale of "
    "their own row; their colour is comparable in all."
)


def report_html(diagnosis: Diagnosis, gains: Gains | None = None) -> str:
    """The page."""
    session = diagnosis.observations.session
    parts = report_parts(diagnosis)
    body = [
        _first_screen(diagnosis),
        _going_on(diagnosis),
        *(_maps(part) for part in parts),
        *(_curves(part) for part in parts),
        _evidence(diagnosis, gains),
        _noise(diagnosis),
    ]
    head = f'<meta charset="utf-8"><title>Diagnosis of {escape(session.name)}</title>'
    style = f"<style>\n{_STYLE.read_text(encoding='utf-8')}</style>"
    return "\n".join(
        [
            "<!doctype html>",
            f'<html lang="en"><head>{head}<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"{style}</head><body>",
            *body,
            "</body></html>",
            "",
        ]
    )


def _first_screen(diagnosis: Diagnosis) -> str:
    observations = diagnosis.observations
    verdict = diagnosis.verdict
    badge = f'<span class="badge {verdict.replace(" ", "-")}">{escape(verdict)}</span>'
    about = (
        f"Session {observations.session.name}: {observations.nominal.device.name}, {observations.nominal.eye} eye, "
        f"{len(observations)} readings in {len(observations.captures)} captures"
    )
    steps = "".join(f"<li>{_typeset(step)}</li>" for step in advice(diagnosis))
    beware = "".join(f"<p>{_typeset(warning)}</p>" for warning in warnings(diagnosis))
    return "\n".join(
        [
            f"<header><p>{badge} &nbsp;{escape(about)}</p><h1>{_typeset(verdict_sentence(diagnosis))}</h1></header>",
            f'<div class="first"><div><h3>What to do</h3><ol>{steps}</ol>',
            f'<div class="warnings">{beware}</div></div>' if beware else "</div>",
            f'<div class="bars"><h3>Residual, rms per axis</h3>{_bars(diagnosis)}</div></div>',
            _tables([report_tables.causes_table(diagnosis)]),
        ]
    )


def _bars(diagnosis: Diagnosis) -> str:
    """Residuals and noise of each part, as bars to one scale per part."""
    found = [("as described", "before", diagnosis.before), ("extended", "after", diagnosis.after)]
    states = [*found[: 2 if diagnosis.causes else 1], ("noise", "noise", diagnosis.noise)]
    lines = []
    for name, attribute, unit in FIGURES:
        if getattr(diagnosis.before, attribute) is None:
            continue
        lines.append(f"<h4>{escape(name)}</h4>")
        longest = max(getattr(figures, attribute) for _, _, figures in states)
        for label, kind, figures in states:
            value = getattr(figures, attribute)
            fill = f'<div class="fill {kind}" style="width:{100 * value / longest:.1f}%"></div>'
            number = escape(cell_text(value) + unit)
            lines.append(f'<div class="bar"><span>{label}</span><div class="track">{fill}</div>{number}</div>')
    return "\n".join(lines)


def _going_on(diagnosis: Diagnosis) -> str:
    limits = _tables([report_tables.limits_table(diagnosis)])
    if not diagnosis.causes:
        return _section("How to go on", "<p>Nothing was found to extend the bench by; go on with its file.</p>", limits)
    plan = diagnosis.observations.session.plan
    both = plan.display is not None and plan.see_through is not None
    verbs = ("diagnose extended --out again", "calibrate --captures extended")[: 2 if both else 1]
    lines = [f"wlr-render {verb}" for verb in verbs]
    if diagnosis.extended.device is not diagnosis.observations.nominal.device:
        lines.append("wlr-render render extended/device.toml desk")
    return _section(
        "How to go on",
        "<p>The folder <code>extended</code>, written with this report, is a session: the readings that counted, and "
        "the bench with the causes at work, with a headset of its own where that is changed. See that it predicts "
        "them, and go on with it:</p>",
        "<pre>" + "\n".join(lines) + "</pre>",
    )


def _maps(part: ReportPart) -> str:
    picture = _figure(pictures.png(pictures.residual_maps(part)), f"{part.name} residual over the field", _MAP_TEXT)
    return _section(f"Residual over the field: {part.name}", picture)


def _curves(part: ReportPart) -> str:
    name = f"{part.name} residual against each variable"
    return _section(
        f"Residual against each variable: {part.name}",
        _figure(pictures.png(pictures.residual_curves(part)), name, _BAND_TEXT),
    )


def _evidence(diagnosis: Diagnosis, gains: Gains | None) -> str:
    first = [report_tables.figures_table(diagnosis), *([report_tables.gains_table(gains)] if gains else [])]
    makers = (
        report_tables.parameters_table,
        report_tables.ranking_table,
        report_tables.overlaps_table,
        report_tables.outliers_table,
        report_tables.unexplained_table,
    )
    reasons = "".join(f"<li>{_typeset(reason)}</li>" for reason in diagnosis.reasons)
    ended = f"<h3>Why the search ended</h3><ul>{reasons}</ul>" if reasons else ""
    return _section("Evidence", _tables([*first, *(make(diagnosis) for make in makers)]), ended)


def _noise(diagnosis: Diagnosis) -> str:
    return _section("How the noise was measured", _tables([report_tables.noise_table(diagnosis)]))


def _section(title: str, *content: str) -> str:
    return "\n".join([f"<section><h2>{escape(title)}</h2>", *content, "</section>"])


def _figure(image: bytes, name: str, caption: str) -> str:
    data = base64.b64encode(image).decode("ascii")
    return (
        f'<figure><img alt="{escape(name)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _tables(tables: Sequence[ReportTable]) -> str:
    """Tables that have rows, each with its title and notes."""
    return "\n".join(_table(table) for table in tables if table.rows)


def _table(table: ReportTable) -> str:
    kinds = [' class="text"' if _is_text(table, column) else "" for column in range(len(table.columns))]
    head = "".join(f"<th{kind}>{escape(column)}</th>" for kind, column in zip(kinds, table.columns, strict=True))
    rows = [
        "".join(f"<td{kind}>{_typeset(cell)}</td>" for kind, cell in zip(kinds, row, strict=True))
        for row in table.text_rows()
    ]
    body = "\n".join(f"<tr>{row}</tr>" for row in rows)
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in table.notes)
    return (
        f"<h3>{escape(table.title)}</h3>"
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table></div>{notes}'
    )


def _typeset(text: str) -> str:
    """Escaped, with the signs that plain text has to spell."""
    return escape(text).replace("+-", "±").replace("-&gt;", "→")


def _is_text(table: ReportTable, column: int) -> bool:
    """Whether a column holds words, which stand to the left."""
    cells = [row[column] for row in table.rows if row[column] is not None]
    return any(isinstance(cell, str) and cell[:1].isalpha() for cell in cells)
