# Faults that are injected into a running relightd. Sanitizers have an allocator of their own.
if(NOT PRT_SANITIZE AND NOT CMAKE_CROSSCOMPILING)
  add_library(faults SHARED ${CMAKE_CURRENT_LIST_DIR}/libfaults.c)
  target_link_libraries(faults PRIVATE prt_options)
  target_compile_options(faults PRIVATE -fno-builtin)
  prt_test(faults_library SOURCES fault/library.c LIBS prt_bake LABELS fault)
  foreach(name allocations operations files)
    prt_test(faults_${name} SOURCES fault/${name}.c LIBS librelight LABELS fault)
    target_include_directories(test_faults_${name} PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service
      ${CMAKE_CURRENT_SOURCE_DIR}/fault)
    target_compile_definitions(test_faults_${name} PRIVATE FAULTS_LIBRARY="$<TARGET_FILE:faults>")
    add_dependencies(test_faults_${name} relightd prt_program faults)
  endforeach()
endif()
