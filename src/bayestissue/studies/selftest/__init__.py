"""What the installed program tests itself by on a user's machine, from published numbers to a resumed fit."""
