"""Parts of a configuration from what a user writes, and conditions that join several of its fields."""
