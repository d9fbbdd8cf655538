"""Foreign injectors: causes that share no code with the loop; most have other forms than it fits."""
