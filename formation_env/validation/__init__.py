"""What a user gives: checked and converted, its JSON form, warnings that name the user's line."""
