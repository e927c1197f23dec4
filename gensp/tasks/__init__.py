"""What is done with one item of a stage; picklable, without lightning."""
