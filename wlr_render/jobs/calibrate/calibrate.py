"""`calibrate`: fit the models of one or both eyes to whatever was measured, or to a simulation."""

from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions, Subject
from wlr_render.jobs.job import job
from wlr_render.jobs.options import ProgressArgument
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report


@job
def calibrate(options: CalibrateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Calibrate what `options.path` is; writes model.json and the report into `options.out`.

    Of photographs it also writes station-EYE.json and captures-EYE.npz, of a device captures-EYE.npz.

    Raises:
        BadInputError: the path is nothing that can be calibrated, an option does not apply to it, the input is faulty,
            or it does not determine the models. Of photographs, what was read is kept then, and the report says how
            far the calibration came.
    """
    subject = options.subject
    options.require_for(subject)
    # Each way needs other modules, and --help none of them.
    if subject is Subject.PHOTOGRAPHS:
        from wlr_render.jobs.calibrate.photos import calibrated, report_of

        return report_of(calibrated(options, progress=progress), options)
    if subject is Subject.DEVICE:
        from wlr_render.jobs.calibrate.calibrate_device import calibrate_device

        return calibrate_device(options, progress=progress)
    from wlr_render.jobs.calibrate.captures import calibrate_captures

    return calibrate_captures(options, progress=progress)
