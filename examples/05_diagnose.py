"""Diagnose a bench session: find the physical cause of the residuals, and write a corrected bench model."""

from pathlib import Path

from wlr_render.atomic_files import output_folder
from wlr_render.bench.session_folder import load_session, save_session
from wlr_render.diagnosis.explain import advice, verdict_sentence
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report import diagnosis_report
from wlr_render.report.save import save_report

# bench.toml describes the nominal bench; one of its values is wrong (data/README.md says which).
# docs/bench-session.md has the format for your own sessions.
bench, session = load_session(Path(__file__).parent / "data" / "session")
found = diagnose(bench, session)
print(verdict_sentence(found), *advice(found), sep="\n")

out = output_folder("out/diagnose")
save_report(diagnosis_report(found, folder=out), out, "diagnosis")
save_session(out / "corrected", found.corrected, found.observations.of_rows(found.used).session)
