"""The verb `plan`: where to put the camera, and how many photographs reach an accuracy."""
