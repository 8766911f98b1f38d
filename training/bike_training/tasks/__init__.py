"""What is learned: observation, action, reward terms and failure."""
