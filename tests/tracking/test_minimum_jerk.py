import numpy as np

from wlr_render.tracking.minimum_jerk import minimum_jerk


def test_it_goes_all_the_way_without_turning_back_and_is_the_same_backwards() -> None:
    x = np.linspace(0, 1, 101)
    way = minimum_jerk(x)
    assert (way[0], way[-1]) == (0.0, 1.0)
    assert np.all(np.diff(way) > 0)
    np.testing.assert_allclose(way + way[::-1], 1.0, atol=1e-15)


def test_at_both_ends_it_is_at_rest_and_without_acceleration() -> None:
    step = 1e-4
    for end in (0.0, 1.0):
        before, at, after = minimum_jerk(end - step), minimum_jerk(end), minimum_jerk(end + step)
        assert abs(after - before) / (2 * step) < 1e-6
        assert abs(after - 2 * at + before) / step**2 < 1e-6
