"""The supervision around the thesis's law: which part has failed, and the action that follows.

Other cars, the tests of all hypotheses, the verdict, the model of the loss and the transfer of F̂ to
the loss; what stands in for a missing or wrong measurement; begin, standby and safe stop. Imports
`core`; the controller and the layout import this package.
"""
