cdef extern from *:
    """
    #include <netinet/in.h>
    #include <sys/socket.h>
    #include <sys/uio.h>
    #include <errno.h>
    #ifndef __linux__
    struct mmsghdr { struct msghdr msg_hdr; unsigned int msg_len; };
    static int recvmmsg(int s, struct mmsghdr *m, unsigned int n, int f, void *t) { errno = ENOSYS; return -1; }
    static int sendmmsg(int s, struct mmsghdr *m, unsigned int n, int f) { errno = ENOSYS; return -1; }
    #endif
    """
    cdef struct in_addr:
        unsigned int s_addr

    cdef struct sockaddr_in:
        unsigned short sin_family
        unsigned short sin_port
        in_addr sin_addr

    cdef struct iovec:
        void *iov_base
        size_t iov_len

    cdef struct msghdr:
        void *msg_name
        unsigned int msg_namelen
        iovec *msg_iov
        size_t msg_iovlen
        void *msg_control
        size_t msg_controllen

    cdef struct mmsghdr:
        msghdr msg_hdr
        unsigned int msg_len

    cdef struct cmsghdr:
        size_t cmsg_len
        int cmsg_level
        int cmsg_type

    const int MSG_DONTWAIT
    size_t CMSG_SPACE(size_t)
    size_t CMSG_LEN(size_t)
    cmsghdr *CMSG_FIRSTHDR(msghdr *)
    unsigned char *CMSG_DATA(cmsghdr *)
    int recvmmsg(int, mmsghdr *, unsigned int, int, void *)
    int sendmmsg(int, mmsghdr *, unsigned int, int)
    Py_ssize_t sendmsg(int, msghdr *, int)

cdef int _BATCH, _MOST_SEGMENTS, _DATAGRAM_BYTES, _UDP_SEGMENT, _ANCILLARY_BYTES
cdef object _TIMESPEC, _CANNOT

cdef class Datagrams:
    cdef readonly int sent
    cdef object _socket, _destination
    cdef bint _segments
    cdef sockaddr_in _name
    cdef mmsghdr[64] _headers
    cdef iovec[64] _vectors
    cdef char[32768] _data
    cdef char[2048] _ancillary

    cpdef list receive(self, object times)
    cdef list _receive_one_by_one(self, object times)
    cpdef object send(self, object datagrams)
    cdef object _send_one_by_one(self, object datagrams)
    cdef object _send_some(self, object datagrams)
    cdef bint _send_segments(self, int count, Py_ssize_t length) except -1
