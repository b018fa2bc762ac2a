"""From a folder of photographs to fitted models and a report; and such folders simulated."""
