// How a sensor says in SensorState.blind that the addresses of DDS on its host have changed.
#ifndef RIPS_SERVICES_MODEL_DDS_PROBLEM_H_
#define RIPS_SERVICES_MODEL_DDS_PROBLEM_H_

namespace rips::model {

// The reason begins so; what changed follows. It is alerted at once, and a sensor that says so in
// its hello has not restarted by itself.
inline constexpr char kDdsBeginsAgain[] = "DDS begins again: ";

}  // namespace rips::model

#endif  // RIPS_SERVICES_MODEL_DDS_PROBLEM_H_
