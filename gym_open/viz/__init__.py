"""Show what gym-open makes: in Rerun, or as films and figures. No other package imports rerun."""
