// The sequence numbers that Cyclone holds of a writer on the wire, from C: the headers that know
// them do not compile as C++. Internal to services/dds.
#ifndef RIPS_SERVICES_DDS_WRITER_NUMBERS_H_
#define RIPS_SERVICES_DDS_WRITER_NUMBERS_H_

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct ddsi_sertype;

struct rips_dds_numbers {
  uint64_t next;       // the lowest that is not dropped as old
  uint64_t last;       // the highest that the writer is known to have written
  uint64_t discarded;  // bytes of samples dropped, as old or for want of room
};

// Of any writer that discovery shows, also of discovery itself; `guid` has 16 bytes as on the wire.
// `type` is in use by a topic of the domain. False if there is no such writer.
bool rips_dds_numbers_of(const struct ddsi_sertype* type, const uint8_t* guid,
                         struct rips_dds_numbers* numbers);

// As if nothing had been received of that writer: lower numbers count again, and a reliable writer
// is asked for what it keeps. False if there is no such writer.
bool rips_dds_forget_numbers(const struct ddsi_sertype* type, const uint8_t* guid);

#ifdef __cplusplus
}
#endif

#endif  // RIPS_SERVICES_DDS_WRITER_NUMBERS_H_
