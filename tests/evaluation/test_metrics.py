import numpy as np

from wlr_render.evaluation import metrics


def test_summary_omits_and_counts_nan() -> None:
    errors = np.concatenate([np.arange(101.0), [np.nan, np.nan]])
    result = metrics.summary(errors.reshape(1, -1))
    assert (result.median, result.p95, result.maximum) == (50, 95, 100)
    assert (result.count, result.missing) == (101, 2)
    assert result.rms == np.sqrt(np.mean(np.arange(101.0) ** 2))
    assert np.isnan(metrics.summary([np.nan]).median)
