"""The contract between simulator, training and driving: observation, action, actor, bundle; numpy only."""
