"""The results of an evaluation as Markdown and JSON, with the leaderboard."""
