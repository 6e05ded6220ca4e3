# Which scattering a bake takes, and where the dipole differs from walks.
add_test(NAME scattering COMMAND ${CMAKE_CURRENT_LIST_DIR}/scattering.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(scattering PROPERTIES LABELS unit)
