"""What the commands share: options read, output printed, files read, written and locked."""
