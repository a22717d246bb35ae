// One function for each alternative of a variant, for std::visit: leaving one out does not compile.
#ifndef RIPS_SERVICES_BASE_OVERLOADED_H_
#define RIPS_SERVICES_BASE_OVERLOADED_H_

namespace rips {

template <typename... Functions>
struct Overloaded : Functions... {
  using Functions::operator()...;
};
template <typename... Functions>
Overloaded(Functions...) -> Overloaded<Functions...>;

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_OVERLOADED_H_
