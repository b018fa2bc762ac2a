"""Explain a measured session: what the simulation gets wrong, why, and the bench that gets it right."""

from pathlib import Path

import numpy as np
from oracle.captures import Plan
from oracle.effects import draw_effect
from oracle.session_writer import write_session

from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report_html import report_html
from wlr_render.diagnosis.report_text import advice, verdict_sentence
from wlr_render.files import write_text
from wlr_render.simulation.session_folder import load_session, save_session

# A session as a bench delivers it: bench.toml says what its makers believe. The target was not printed as they think.
# A session of your own is such a folder too: docs/bench-session.md.
rng = np.random.default_rng(5)
secret = draw_effect("target_scale", rng)
write_session(Path("session"), Plan("northstar", grid=(12, 9), dots=(9, 6)), [secret], rng)

bench, session = load_session("session")
found = diagnose(bench, session)
print(verdict_sentence(found), *advice(found), sep="\n")
print("hidden was:", secret.name, secret.amount)

write_text("diagnosis.html", report_html(found))
save_session("extended", found.extended, found.observations.of_rows(found.used).session)
