"""From captures to models; sees captures only."""
