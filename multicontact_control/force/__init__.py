"""Force dynamics of one contact: its plant, its observer, its noise."""
