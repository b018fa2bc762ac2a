"""Explain a measured session: why the simulation differs from it, and the corrected bench."""

from pathlib import Path

from wlr_render.diagnosis.explain import advice, verdict_sentence
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report import diagnosis_report
from wlr_render.files import output_folder
from wlr_render.report.save import save_report
from wlr_render.simulation.session_folder import load_session, save_session

# A session as a bench delivers it: bench.toml says what its makers believe, and something is not as they believe.
# data/README.md says what. A session of your own is such a folder too: docs/bench-session.md.
bench, session = load_session(Path(__file__).parent / "data" / "session")
found = diagnose(bench, session)
print(verdict_sentence(found), *advice(found), sep="\n")

out = output_folder("out/diagnose")
save_report(diagnosis_report(found), out, "diagnosis")
save_session(out / "corrected", found.corrected, found.observations.of_rows(found.used).session)
