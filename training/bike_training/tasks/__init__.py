"""Tasks: observation, action, reward terms and failure."""
