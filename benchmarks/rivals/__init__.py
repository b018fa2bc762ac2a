"""Published methods beside ours on measurements of others, each judged by data that it was not fitted to."""
