"""Looking: any log, release or policy as a Rerun recording. The only package that imports rerun."""
