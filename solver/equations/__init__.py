"""A machine's equations as symbols: coordinates, forces, contacts, friction, and the model they make up."""
