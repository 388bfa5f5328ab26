from particles_mpi.cli import main

main()
