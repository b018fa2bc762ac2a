"""From captures to models; does not import the exact optics."""
