"""What a machine is: file, units, rules, mechanism matrix, faults, drawings; ``shipped/`` comes with the program."""
