"""One module an element. A new one is found here by itself: see `elements.element.Element`."""
