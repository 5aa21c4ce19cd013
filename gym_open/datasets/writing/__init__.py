"""Episodes, of logs or of releases, become the files of a release."""
