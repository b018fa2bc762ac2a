"""Sequential prescriptions of Zemax, Optiland and rayoptics, and the headsets they become."""
