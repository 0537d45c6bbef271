"""What goes wrong over a drive: clocks that walk and step, reports that come late or twice."""
