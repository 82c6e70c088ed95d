"""What each kind of robot is: where it may stand, what its steps cost, how it is searched for."""
