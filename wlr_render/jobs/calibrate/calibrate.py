"""`calibrate`: fit the models of one or both eyes to measurements of any kind, or to a simulation."""

from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions, Subject
from wlr_render.jobs.job import job
from wlr_render.jobs.options import ProgressArgument
from wlr_render.report.blocks import Report
from wlr_render.work.progress import SILENT


@job
def calibrate(options: CalibrateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Calibrate the headset of `options.path`; write model.json and the report into `options.out`.

    Photographs also give station-EYE.json and captures-EYE.npz, a device gives captures-EYE.npz.

    Raises:
        BadInputError: the path cannot be calibrated, an option does not apply to it, the input is faulty, or it does
            not determine the models. In the last case the readings of photographs are kept, and the report shows how
            far the calibration got.
    """
    subject = options.subject
    options.require_for(subject)
    # Each kind of input needs different modules, and --help needs none of them.
    if subject is Subject.PHOTOGRAPHS:
        from wlr_render.jobs.calibrate.photos import calibrated, report_of

        return report_of(calibrated(options, progress=progress), options, progress)
    if subject is Subject.DEVICE:
        from wlr_render.jobs.calibrate.calibrate_device import calibrate_device

        return calibrate_device(options, progress=progress)
    if subject is Subject.ALIGNMENTS:
        from wlr_render.jobs.calibrate.alignments import calibrate_alignments

        return calibrate_alignments(options, progress=progress)
    from wlr_render.jobs.calibrate.captures import calibrate_captures

    return calibrate_captures(options, progress=progress)
