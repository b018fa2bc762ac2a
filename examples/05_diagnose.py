"""Diagnose a bench session: find the physical cause of the residuals, and write a corrected bench model.

One value of the session's bench.toml is wrong: data/README.md says which. docs/bench-session.md has the format for your
own sessions.
"""

from pathlib import Path

import wlr_render as wlr

bench, session = wlr.load_session(Path(__file__).parent / "data" / "session")
diagnosis = wlr.diagnose(bench, session)
print(diagnosis)  # the verdict, then what to do
diagnosis.save("out/diagnose")  # the report, and the session with the corrected bench
