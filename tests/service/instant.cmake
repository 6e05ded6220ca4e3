# Models without a bake, with a live relightd; the exact sum they are measured against is libprt's.
foreach(name instant preview_shape preview_media views_by_name slow_view)
  prt_test(${name} SOURCES service/${name}.c service/ball.c LIBS librelight prt LABELS service)
  target_include_directories(test_${name} PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
  add_dependencies(test_${name} relightd prt_program)
endforeach()
