"""What accuracy costs, and what stays right in hard cases: `particles-mpi study`."""
