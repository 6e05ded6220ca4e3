# The patches follow the code: each applies, and names tests that exist. `run` builds them.
if(NOT CMAKE_CROSSCOMPILING)
  add_test(NAME mutants COMMAND ${CMAKE_SOURCE_DIR}/tests/mutants/run --applies ${CMAKE_BINARY_DIR})
  set_tests_properties(mutants PROPERTIES LABELS unit)
endif()
