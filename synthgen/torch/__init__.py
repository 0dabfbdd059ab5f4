"""What needs torch: training of the registration's initialiser."""
