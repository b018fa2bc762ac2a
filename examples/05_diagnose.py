"""Explain a measured session: what the simulation gets wrong, why, and the bench that gets it right."""

from pathlib import Path

from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report_html import report_html
from wlr_render.diagnosis.report_text import advice, verdict_sentence
from wlr_render.files import output_folder, write_text
from wlr_render.simulation.session_folder import load_session, save_session

# A session as a bench delivers it: bench.toml says what its makers believe, and something is not as they believe.
# data/README.md says what. A session of your own is such a folder too: docs/bench-session.md.
bench, session = load_session(Path(__file__).parent / "data" / "session")
found = diagnose(bench, session)
print(verdict_sentence(found), *advice(found), sep="\n")

out = output_folder("out/diagnose")
write_text(out / "diagnosis.html", report_html(found))
save_session(out / "extended", found.extended, found.observations.of_rows(found.used).session)
