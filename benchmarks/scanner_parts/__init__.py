"""What the scanner's benchmarks are made of: targets with known surfaces, tests, pictures."""
