# Small bodies; under the label long those with more vertices.
prt_test(walk_bake SOURCES ${CMAKE_CURRENT_LIST_DIR}/walk_bake.c physics/bodies.c LIBS prt_bake LABELS physics)
add_test(NAME walk_bake_long COMMAND test_walk_bake long)
set_tests_properties(walk_bake_long PROPERTIES TIMEOUT 3000 LABELS "physics;long")
