"""What an impactor meets: oscillators in closed form, elements by their force laws, outcomes of a motion."""
