"""What a scene file says, and the plan that follows from it."""
