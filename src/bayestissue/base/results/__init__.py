"""Result folders: whole or not there, never at the cost of anything but earlier results."""
