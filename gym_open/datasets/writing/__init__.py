"""Write the files of a release from episodes of logs or of other releases."""
