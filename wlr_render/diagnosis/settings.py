"""The numbers that decide a diagnosis, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Thresholds and limits of a diagnosis.

    Attributes:
        significant_se: standard errors from which two variances differ: chance exceeds 3 in one of 700 comparisons.
        material_variance: share of a variance below which a difference changes neither verdict nor error bars by much.
        outlier_reading: residual of a single reading over the noise of its photograph from which it is an outlier;
            neither noise nor a smooth effect is so far off.
        same_noise: relative change of sigma below which the causes are not selected again with the new sigma.
        subsample: readings on which candidates are compared first; all readings are used for the few that remain.
        max_causes: causes that are searched for; more than five are not told apart by one session.
        min_relative_gain: share of the best candidate's first-order gain below which a candidate is not fitted.
        max_fits: candidates that are fitted for each place.
        max_contenders: candidates that are fitted again to all readings.
        close_evidence: difference of -2 log evidence beyond which a candidate is not fitted to all readings: the
            subsample cannot be wrong by odds of exp(20).
        max_p_value: probability that chance alone gains as much, below which a cause may be added.
        min_held_out_se: standard errors by which held-out captures must be predicted better.
        min_share_explained: share of what exceeds the noise that a cause must explain, unless the rest is noise. A
            cause that explains less beside something unlisted is more often a spurious match than a true cause.
        max_idle_ratio: reduced chi-squared without a cause over that with it, up to which the cause may be idle.
        restarts: runners-up of the first place from which the selection is tried again: of two causes at work, the
            one that alone explains most may be neither.
        restart_ratio: reduced chi-squared of a runner-up over the best candidate's, up to which it is worth a restart.
        max_instability: change of a cause's effect between halves of the readings, over the effect, from which the
            cause is a spurious match; true causes beside unlisted effects stayed below 0.1 in tests.
        max_prior_sigmas: values beyond so many prior sigmas want another explanation.
        whole_step_choices: multiples of a whole step that are equally likely beforehand.
        moved_capture_gain: chi-squared per degree of freedom that a camera pose of its own must gain a capture.
        moved_capture_spread: robust standard deviations above the median of all captures, likewise.
        max_moved_captures: share of the captures beyond which none is an outlier, as what they share is a cause.
        outlier_rounds: times that captures that moved are searched for and excluded.
        min_structure_percent: improvement on held-out captures from which a smooth correction counts as structure.
        min_structure_se: standard errors of the same.
        degenerate_cosine: cosine between an effect and its best match by another cause, from which the two are called
            degenerate; a tenth of the effect then tells them apart.
        decisive_odds: log10 odds against a degenerate cause beyond which the session decides.
        max_condition: condition of the correlations between values from which the report warns.
        detection_limit_se: standard errors that make a detection limit.
    """

    significant_se: float = 3.0
    material_variance: float = 0.1
    outlier_reading: float = 6.0
    same_noise: float = 0.02
    subsample: int = 6000
    max_causes: int = 5
    min_relative_gain: float = 0.3
    max_fits: int = 10
    max_contenders: int = 5
    close_evidence: float = 40.0
    max_p_value: float = 1e-3
    min_held_out_se: float = 2.0
    min_share_explained: float = 0.3
    max_idle_ratio: float = 1.2
    restarts: int = 2
    restart_ratio: float = 3.0
    max_instability: float = 0.35
    max_prior_sigmas: float = 20.0
    whole_step_choices: int = 5
    moved_capture_gain: float = 25.0
    moved_capture_spread: float = 6.0
    max_moved_captures: float = 0.1
    outlier_rounds: int = 3
    min_structure_percent: float = 1.0
    min_structure_se: float = 4.0
    degenerate_cosine: float = 0.95
    decisive_odds: float = 4.34  # odds of exp(10)
    max_condition: float = 1e4
    detection_limit_se: float = 5.0


DEFAULT = Settings()
