# prt-bench: every .c file here is a benchmark (see bench.h). Some measure the daemon from a
# client's side: they need its program beside them.
file(GLOB prt_bench_sources CONFIGURE_DEPENDS ${CMAKE_CURRENT_LIST_DIR}/*.c)
add_executable(prt-bench ${prt_bench_sources})
target_include_directories(prt-bench PRIVATE ${CMAKE_SOURCE_DIR}/libprt) # bake/measure_inner.h
target_link_libraries(prt-bench PRIVATE prt_options prt librelight relight_proto ${CJSON_LIBRARY} m)
add_dependencies(prt-bench relightd)
install(TARGETS prt-bench RUNTIME DESTINATION bin)
