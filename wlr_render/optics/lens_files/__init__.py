"""Sequential prescriptions of Zemax, CODE V, Optiland and rayoptics, and their conversion to headsets."""
