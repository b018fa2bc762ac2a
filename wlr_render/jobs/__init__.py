"""What users run: one module or folder for each verb, with its options, its function and its report."""
