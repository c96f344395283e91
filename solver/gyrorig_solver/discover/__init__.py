"""What the model of the rig gets wrong: found, named, fitted, and its worth measured."""
