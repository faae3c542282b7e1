"""What other sensors saw, on the cloud: near-infrared, temperature, dose rate; and surveys brought together."""
