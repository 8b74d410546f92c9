"""From a log's raw detections to the one frozen stream that every back end is given."""
