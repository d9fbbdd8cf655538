"""Contacts of simulators that run many environments at once, as samples for `predictor.fingers`.

Each adapter turns the arrays that its simulator documents into a `taxel.contacts.ContactSample`. None was
run with its simulator: the tests give them tensors of the documented shapes.
"""
