"""What a photograph of a real set-up needs: calibration boards, and OpenCV, which finds them."""
