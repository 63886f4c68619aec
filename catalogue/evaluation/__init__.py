"""How good diagnoses are: on freshly simulated recordings no catalogue has seen, through the whole of diagnosis."""
