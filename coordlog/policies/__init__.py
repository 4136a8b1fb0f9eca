"""What acts: scripted experts, noise, the velocity damper, and learned networks."""
