"""Factory calibrations of headsets: directions of panel pixels from one pupil position, without optics."""
