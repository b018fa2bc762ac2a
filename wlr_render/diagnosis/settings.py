"""The numbers that decide a diagnosis, each with its reason."""

from dataclasses import dataclass

BEYOND_DOUBT = 20.0
"""Log10 odds from which the readings have structure, whether or not it predicts captures left out."""


@dataclass(frozen=True)
class Settings:
    """Thresholds and limits of a diagnosis.

    Attributes:
        material_excess: relative excess of the variance of a residual without structure over the noise from which it is
            an effect; the noise that neighbours share is not known better.
        subsample: readings on which candidates are compared first; all readings are used for the few that remain.
        max_causes: causes that are searched for; one session does not distinguish more than five.
        least_log10_odds: least odds for a cause, or for an effect at a station, and for a cause's name against the
            fields of its station: 2 is a chance of one in a hundred for each.
        min_share_explained: share of what exceeds the noise of a part that a cause must explain, unless the rest is
            noise.
        min_share_located: share of the excess of captures left out that a located effect must remove, or something is
            left: motions of the captures may hide it.
        min_relative_gain: share of the best candidate's first-order gain below which a candidate is not fitted.
        max_fits: candidates that are fitted for each place.
        max_contenders: candidates that are fitted again to all readings.
        close_evidence: difference of -2 log evidence on the subsample beyond which a candidate is not fitted to all
            readings, which are only more decided.
        restarts: runners-up of the first place from which the selection is tried again: of two causes at work, the
            one that alone explains most may be neither.
        max_prior_sigmas: largest believable value, in prior sigmas; larger values need another explanation.
        max_moved_captures: largest share of a part's captures that may have moved; beyond it they cannot be identified.
        degenerate_share: share of a cause's gain that another one reaches to first order, from which the two are called
            degenerate.
        decisive_odds: log10 odds against a degenerate cause beyond which the session decides.
        max_condition: condition of the correlations between values from which the report warns.
        detection_limit_se: standard errors that make a detection limit.
    """

    material_excess: float = 0.25
    subsample: int = 6000
    max_causes: int = 5
    least_log10_odds: float = 2.0
    min_share_explained: float = 0.3
    min_share_located: float = 0.5
    min_relative_gain: float = 0.3
    max_fits: int = 6
    max_contenders: int = 3
    close_evidence: float = 20.0
    restarts: int = 1
    max_prior_sigmas: float = 20.0
    max_moved_captures: float = 0.34
    degenerate_share: float = 0.9
    decisive_odds: float = 4.34  # odds of exp(10)
    max_condition: float = 1e4
    detection_limit_se: float = 5.0


DEFAULT = Settings()
