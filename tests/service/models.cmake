# The registry of a live relightd: copies of --models, names, ids, budgets on disk.
prt_test(models SOURCES service/models.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_models PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service ${CMAKE_SOURCE_DIR}/proto)
add_dependencies(test_models relightd prt_program)
