"""The accuracy with which a few clicks restore the registration of a worn headset after slips."""
