"""
Force laws and noise estimators by name, each with the place of what implements it.

A new one is a file and one line here. The configuration, the command line and the studies take
the names from here, in this order, without importing what they stand for: the configuration lies
below the force laws, and the command line prints its help before numpy is loaded.
"""

# The place is a module and an object in it, as `pkgutil.resolve_name` reads it.
FORCE_LAWS = {
    'aob': 'multicontact_control.force.laws.aob:LAW',
    'pi': 'multicontact_control.force.laws.pi:LAW',
    'dob': 'multicontact_control.force.laws.dob:LAW',
    'lqg': 'multicontact_control.force.laws.lqg:LAW',
    'admittance': 'multicontact_control.force.laws.admittance:LAW',
    'impedance': 'multicontact_control.force.laws.impedance:LAW',
    'feedforward': 'multicontact_control.force.laws.feedforward:LAW',
}
NOISE_ESTIMATORS = {
    'lead_window': 'multicontact_control.force.noise.window:LeadWindowEstimator',
    'hf_window': 'multicontact_control.force.noise.window:HfWindowEstimator',
    'window': 'multicontact_control.force.noise.window:WindowEstimator',
    'fixed': 'multicontact_control.force.noise.fixed:Fixed',
    'innovation': 'multicontact_control.force.noise.innovation:InnovationWindow',
    'sage_husa': 'multicontact_control.force.noise.sage_husa:SageHusa',
    'variational_bayes': 'multicontact_control.force.noise.variational_bayes:VariationalBayes',
}
