"""The policies: programmed ones as code, learned ones as the files that are shipped."""
