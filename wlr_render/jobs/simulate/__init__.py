"""`simulate`: write a session of photographs as a lab would deliver it."""
