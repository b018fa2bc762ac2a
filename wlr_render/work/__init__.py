"""Work spread over processes and machines, and its progress."""
