import numpy as np

from wlr_render.mappings import Status, count_unsolved


def test_statuses_except_ok_are_counted_by_name_over_all_arrays() -> None:
    first = np.zeros((3, 4), np.uint8)
    first[0, :2] = Status.NOT_CONVERGED
    second = np.array([Status.OUTSIDE_FIT, Status.NOT_CONVERGED, Status.OK], np.uint8)
    assert count_unsolved([first, second]) == {"outside fit": 1, "not converged": 3}
    assert count_unsolved([np.zeros((2, 2), np.uint8)]) == {}
