"""Numbers of an agent on a task over runs: read from scores, named and summarised for reports and figures."""
