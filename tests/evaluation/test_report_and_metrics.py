import json

import numpy as np

from wlr_render.evaluation import metrics, report


def test_summary_leaves_out_and_counts_what_is_missing():
    errors = np.concatenate([np.arange(101.0), [np.nan, np.nan]])
    result = metrics.summary(errors.reshape(1, -1))
    assert (result.median, result.p95, result.maximum) == (50, 95, 100)
    assert (result.count, result.missing) == (101, 2)
    assert result.rms == np.sqrt(np.mean(np.arange(101.0) ** 2))
    assert np.isnan(metrics.summary([np.nan]).median)


def test_table_as_markdown_and_json_round_trip():
    table = report.ReportTable("T", ["name", "error (arcmin)"], [["a", 0.24321], ["b", np.nan], ["c", 3e-6]], ["note"])
    text = table.markdown()
    assert "| a | 0.243 |" in text
    assert "| b | - |" in text
    assert "| c | 3.0e-06 |" in text
    record = json.loads(report.tables_as_json([table], seed=7))
    assert record["seed"] == 7
    assert record["tables"][0]["rows"][0]["error (arcmin)"] == 0.24321
    assert record["tables"][0]["rows"][1]["error (arcmin)"] is None
