# Embree 4 where it is (Debian 13), else Embree 3 (Debian 12).
find_package(embree 4 QUIET CONFIG)
if(NOT embree_FOUND)
  find_package(embree 3 REQUIRED CONFIG)
endif()
target_link_libraries(prt_trace PUBLIC embree)
