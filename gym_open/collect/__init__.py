"""Stage 1: exploration policies play in the sandbox, and everything is logged."""
