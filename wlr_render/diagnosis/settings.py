"""Thresholds and limits of a diagnosis, each with its reason."""

from dataclasses import dataclass

BEYOND_DOUBT = 20.0
"""Log10 odds beyond which readings have structure, whether or not it predicts held-out captures."""


@dataclass(frozen=True)
class Settings:
    """Thresholds and limits of a diagnosis.

    Attributes:
        material_excess: relative excess variance of a structureless residual over the noise beyond which it counts as
            an effect; the noise that neighbours share is not known more precisely.
        subsample: number of readings on which candidates are first compared; the few that remain use all readings.
        max_causes: largest number of causes; one session does not distinguish more than five.
        least_log10_odds: least odds for a cause, for an effect at a station, and for a cause's name against the fields
            of its station: 2 is a chance of one in a hundred for each.
        min_share_explained: share of a part's excess over the noise that a cause must explain, unless only noise is
            left.
        min_share_located: share of the excess of held-out captures that a located effect must remove; otherwise
            something is left, which motions of the captures may hide.
        min_relative_gain: share of the best candidate's first-order gain below which a candidate is not fitted.
        max_fits: largest number of candidates fitted for each place.
        max_contenders: largest number of candidates fitted again to all readings.
        close_evidence: difference of -2 log evidence on the subsample beyond which a candidate is not fitted to all
            readings, because these only increase the difference.
        restarts: number of runners-up of the first place from which the selection is tried again: if two causes act,
            the one that explains most by its single effect may be neither.
        max_prior_sigmas: largest believable value, in prior sigmas; larger values need another explanation.
        max_moved_captures: largest share of a part's captures that may have moved; with more, they cannot be
            identified.
        degenerate_share: ratio of another cause's first-order gain to a cause's gain from which they are degenerate.
        decisive_odds: log10 odds against a degenerate cause beyond which the session decides.
        max_condition: condition number of the correlations between values beyond which the report warns.
        detection_limit_se: detection limit in standard errors.
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
    decisive_odds: float = 4.34  # log10 of exp(10)
    max_condition: float = 1e4
    detection_limit_se: float = 5.0


DEFAULT = Settings()
