"""Sequential prescriptions of Zemax, CODE V, Optiland and rayoptics, and the headsets they become."""
