# The registry of a live relightd: copies of --models, names, ids, budgets on disk.
prt_test(models SOURCES service/models.c LIBS librelight LABELS service)
target_include_directories(test_models PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_models relightd prt_program)
